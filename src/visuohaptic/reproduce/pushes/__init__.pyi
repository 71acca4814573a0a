from .floor_push import FloorBody as FloorBody
from .floor_push import FloorPush as FloorPush
from .floor_push import FloorTrace as FloorTrace
from .goal_maps import GoalMap as GoalMap
from .goal_maps import goal_map as goal_map
from .local_costmap import FootprintSamples as FootprintSamples
from .local_costmap import LocalCostmap as LocalCostmap
