"""SpotLight at run time: shadow-guided object relighting with numpy and ONNX Runtime.

::

    from spotlight_runtime import Relighter, RelightOptions, Scene

    relighter = Relighter.load("models/zerocomp")
    result = relighter.relight(Scene.load("scene/"), shadow, negative, RelightOptions(seed=469))
    result.image  # (H, W, 3) float32, sRGB-encoded, in [0, 1]
"""

from spotlight_runtime.images import read_image, write_image
from spotlight_runtime.options import RelightOptions
from spotlight_runtime.relighter import Relighter
from spotlight_runtime.result import Progress, RelightResult
from spotlight_runtime.sampler import LoopInputs, Step
from spotlight_runtime.scene import Intrinsics, Scene

__all__ = [
    "Intrinsics",
    "LoopInputs",
    "Progress",
    "RelightOptions",
    "RelightResult",
    "Relighter",
    "Scene",
    "Step",
    "read_image",
    "write_image",
]
