"""SpotLight at run time: shadow-guided object relighting with numpy and ONNX Runtime.

::

    from spotlight_runtime import Light, Relighter, Scene

    relighter = Relighter.load("mini")
    result = relighter.relight(Scene.load("scene/"), Light(azimuth=135, elevation=45), seed=469)
    result.image  # (H, W, 3) float32, sRGB-encoded, in [0, 1]
"""

from spotlight_runtime.guides import GuidingShadow
from spotlight_runtime.images import read_image, write_image
from spotlight_runtime.lights import Light
from spotlight_runtime.options import RelightOptions
from spotlight_runtime.relighter import Relighter
from spotlight_runtime.result import Progress, RelightResult
from spotlight_runtime.sampler import LoopInputs, Step
from spotlight_runtime.scene import Intrinsics, Scene
from spotlight_runtime.window import Window

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
]
