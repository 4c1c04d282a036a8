from ebjax import testing as testing
from ebjax.command import setup_jax as setup_jax
from ebjax.features.extractor import Extractor as Extractor
from ebjax.features.matching import Features as Features
from ebjax.front.close import close_loops as close_loops
from ebjax.front.demo import demo as demo
from ebjax.front.localiser import Localiser as Localiser
from ebjax.front.log import open_log as open_log
from ebjax.front.mapper import Mapper as Mapper
from ebjax.front.run import Run as Run
from ebjax.geometry.camera import Camera as Camera
from ebjax.geometry.camera import FloorView as FloorView
from ebjax.places.descriptor import Descriptor as Descriptor
from ebjax.places.descriptor import Places as Places
from ebjax.posegraph.graph import PoseGraph as PoseGraph
from ebjax.posegraph.graph import make_graph as make_graph
from ebjax.posegraph.lm import solve as solve
from ebjax.slam.frame import Frame as Frame
from ebjax.slam.frame import Update as Update

__version__: str
