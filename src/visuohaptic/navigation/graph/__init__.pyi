from .navigation_graph import NavigationGraph as NavigationGraph
from .navigation_graph import build_graph as build_graph
from .regions import Regions as Regions
from .regions import assign_regions as assign_regions
