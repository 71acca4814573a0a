from .map_records import MapCommand as MapCommand
from .map_records import MapObservation as MapObservation
from .map_records import MapOutcome as MapOutcome
from .map_records import MapSettings as MapSettings
from .map_records import MapState as MapState
from .map_task import TouchMapping as TouchMapping
from .map_task import TouchMapTask as TouchMapTask
from .map_task import map_by_touch as map_by_touch
