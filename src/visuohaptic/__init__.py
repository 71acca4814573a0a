"""Force sensing with a camera and foam, and visuo-haptic perception and planning for robots.

``import visuohaptic as vh`` offers the names that most programs need, grouped in ``__init__.pyi`` by
purpose; each is imported at its first use, so that the import itself costs nothing. Everything else
is in the packages, for example ``from visuohaptic.sensing.push import fit_contact``.
"""

from typing import Any

import lazy_loader

from ._version import __version__ as __version__

_load, _, _lazy = lazy_loader.attach_stub(__name__, __file__)
__all__ = sorted([*_lazy, "__version__"])


def __dir__() -> list[str]:
    return __all__.copy()


def __getattr__(name: str) -> Any:
    found = _load(name)
    from .core.front_door import public

    return public(__name__, name, found)
