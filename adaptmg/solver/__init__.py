"""The methods a user names, solve() around them, and the classes of what results answer."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
