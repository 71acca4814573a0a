from .machine import Machine as Machine
from .machine import Observation as Observation
from .machine import Rule as Rule
from .machine import replay as replay
from .trace import Ending as Ending
from .trace import Step as Step
from .trace import Trace as Trace
