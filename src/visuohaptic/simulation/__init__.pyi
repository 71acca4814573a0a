from .faults import FaultKind as FaultKind
from .faults import FaultyFrames as FaultyFrames
from .faults import FrameFaults as FrameFaults
from .faults import frame_faults as frame_faults
from .faults import wrong_map as wrong_map
