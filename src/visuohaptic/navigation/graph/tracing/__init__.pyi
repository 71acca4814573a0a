from .skeletonize import skeleton as skeleton
