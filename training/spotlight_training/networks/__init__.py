"""The embedded backbone's networks: a small VAE, a latent renderer, and an intrinsics estimator.

Sized for two CPU cores. All of them take any height and width (multiples of 8 pixels, odd latent
sizes included), and so do the exported graphs.

* `VAE`: 8× down, on the principal components of patches.
* `ConditionEncoder` and `Denoiser`: the renderer. Intrinsic maps enter as latents concatenated to
  the noisy latents, as RGB↔X does: the picture as far as it is known through the VAE, so that what
  is copied to the output needs no translation, and all maps through a learned projection. What the
  renderer finds of hidden light, it says in twelve numbers a latent.
* `IntrinsicsNet`: a photograph's albedo, normals and depth.
"""

from spotlight_training.networks.blocks import PATCH
from spotlight_training.networks.condition import ConditionEncoder
from spotlight_training.networks.denoiser import Denoiser
from spotlight_training.networks.intrinsics import IntrinsicsNet
from spotlight_training.networks.vae import VAE

__all__ = ["PATCH", "VAE", "ConditionEncoder", "Denoiser", "IntrinsicsNet"]
