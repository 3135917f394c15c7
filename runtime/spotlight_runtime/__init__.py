"""SpotLight at run time: shadow-guided object relighting with numpy and ONNX Runtime.

::

    from spotlight_runtime import Light, Relighter, Scene

    relighter = Relighter.load("mini")
    result = relighter.relight(Scene.load("scene/"), Light(azimuth=135, elevation=45), seed=469)
    result.image  # (H, W, 3) float32, sRGB-encoded, in [0, 1]
"""

from spotlight_runtime.diffusion.sampler import LoopInputs, Step
from spotlight_runtime.geometry.lights import Light
from spotlight_runtime.imaging.images import read_image, write_image
from spotlight_runtime.imaging.picture_files import write_picture
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.relighting.guides import GuidingShadow
from spotlight_runtime.relighting.relighter import Relighter
from spotlight_runtime.relighting.result import Progress, RelightResult
from spotlight_runtime.relighting.window import Window
from spotlight_runtime.scenes.scene import Intrinsics, Scene

__all__ = [
    "GuidingShadow",
    "Intrinsics",
    "Light",
    "LoopInputs",
    "Progress",
    "RelightOptions",
    "RelightResult",
    "Relighter",
    "Scene",
    "Step",
    "Window",
    "read_image",
    "write_image",
    "write_picture",
]
