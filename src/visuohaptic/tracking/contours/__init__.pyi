from .contour import Contour as Contour
from .contour import ContourSettings as ContourSettings
from .contour import ContourTracker as ContourTracker
from .contour import PointReason as PointReason
from .lines import ConstraintLines as ConstraintLines
from .stripe import StripeModel as StripeModel
