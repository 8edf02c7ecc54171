"""Transfers between meshes, nested or not: point location, prolongations, transport of contact
data."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
