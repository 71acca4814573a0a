from .beam_reader import BeamReader as BeamReader
from .beam_reader import write_templates as write_templates
from .foam_reader import FoamReader as FoamReader
from .load import load_reader as load_reader
from .scene_reader import SceneReader as SceneReader
from .sensor_reader import SensorReader as SensorReader
from .sensor_reader import SensorReading as SensorReading
from .template_reader import TemplateReader as TemplateReader
