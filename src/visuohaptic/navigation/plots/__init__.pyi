from .map_plots import plot_navigation as plot_navigation
from .plan_plots import plot_path_plan as plot_path_plan
