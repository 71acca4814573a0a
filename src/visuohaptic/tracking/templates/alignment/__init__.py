"""Alignment of a template with an image: second-order minimisation, blur, and the fit by blocks."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
