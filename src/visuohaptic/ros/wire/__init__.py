"""What ROS 2 nodes exchange over zenoh: CDR, type hashes, discovery."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
