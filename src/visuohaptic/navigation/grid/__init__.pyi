from .cost_grid import OBSTACLE_FROM as OBSTACLE_FROM
from .cost_grid import GridLayers as GridLayers
from .cost_grid import SpeedLimits as SpeedLimits
from .cost_grid import grid_layers as grid_layers
from .cost_grid import window_distance as window_distance
from .footprints import Footprint as Footprint
from .footprints import FootprintSettings as FootprintSettings
from .footprints import find_footprints as find_footprints
