from .skeletonize import skeleton as skeleton
from .skeletonize import skeleton_marks as skeleton_marks
