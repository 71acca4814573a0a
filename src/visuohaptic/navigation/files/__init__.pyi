from .geojson import save_graph as save_graph
from .geojson import save_route_graph as save_route_graph
from .joint_geojson import save_joint_route_graph as save_joint_route_graph
from .layers import Layer as Layer
from .layers import load_layer as load_layer
from .layers import save_layer as save_layer
from .route_edges import RoutePieces as RoutePieces
from .route_edges import route_pieces as route_pieces
