from .guided_platform import GuidedPlatform as GuidedPlatform
from .house import House as House
from .house import door_row as door_row
from .house import office_house as office_house
from .plan import FloorPlan as FloorPlan
from .plan import draw_plan as draw_plan
from .random_house import random_house as random_house
