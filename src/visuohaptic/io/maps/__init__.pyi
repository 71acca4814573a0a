from .occupancy_map import FREE as FREE
from .occupancy_map import OCCUPIED as OCCUPIED
from .occupancy_map import UNKNOWN as UNKNOWN
from .occupancy_map import OccupancyMap as OccupancyMap
