"""Problems whose steps follow from one another: in a load path, in time, or in a history of the
material."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
