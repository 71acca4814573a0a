from .depth_fusion import TsdfVolume as TsdfVolume
from .depth_noise import SENSOR_NOISE as SENSOR_NOISE
from .depth_noise import DepthNoise as DepthNoise
from .depth_noise import sensor_noise as sensor_noise
from .volume import SpaceGrid as SpaceGrid
from .volume import space_of_interest as space_of_interest
