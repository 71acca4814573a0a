from .pane_fit import Pane as Pane
from .pane_fit import find_panes as find_panes
