from .exact_search import GridOptimum as GridOptimum
from .exact_search import Proof as Proof
from .exact_search import certify as certify
from .exact_search import solve_exact as solve_exact
