from .exact_search import Oracle as Oracle
from .exact_search import Proof as Proof
from .exact_search import prove as prove
from .exact_search import solve_exact as solve_exact
