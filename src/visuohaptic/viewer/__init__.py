"""The live page in the browser, bound to this machine only."""

from .page import LivePage

__all__ = ["LivePage"]
