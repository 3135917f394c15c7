"""Open Image Denoise, for backbones trained on noisy renders. Needs the extra ``denoise``."""

from __future__ import annotations

import importlib.util
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from spotlight_runtime.arrays import FloatArray, require_finite
from spotlight_runtime.errors import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["denoise", "denoiser_available", "require_denoiser"]


def denoiser_available() -> bool:
    """Whether the optional denoiser is installed."""
    return importlib.util.find_spec("pyoidn") is not None


def require_denoiser() -> None:
    """Raise unless the optional denoiser is installed.

    Raises
    ------
    MissingExtraError
        Naming the pip command.
    """
    if not denoiser_available():
        raise MissingExtraError(
            "denoising needs Open Image Denoise: pip install 'spotlight-relight[denoise]', "
            "or relight without it (denoise=False, --no-denoise)"
        )


def denoise(
    linear: FloatArray, albedo: FloatArray | None = None, normal: FloatArray | None = None
) -> FloatArray:
    """Denoise a low-dynamic-range image at high quality, guided by clean albedo and normals.

    Parameters
    ----------
    linear : ndarray of float32, shape (H, W, 3)
        Linear light in [0, 1].
    albedo : ndarray of float32, shape (H, W, 3), optional
        In [0, 1].
    normal : ndarray of float32, shape (H, W, 3), optional
        In [−1, 1]; the denoiser takes normals only together with albedo.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)

    Raises
    ------
    MissingExtraError
        If Open Image Denoise is not installed.
    NumericalError
        If it returns NaN or infinity.
    """
    require_denoiser()
    with _without_torch():
        import pyoidn
    auxiliaries = {} if albedo is None else {"albedo": np.ascontiguousarray(albedo)}
    if albedo is not None and normal is not None:
        auxiliaries["normal"] = np.ascontiguousarray(normal)
    clean: Any = pyoidn.denoise(np.ascontiguousarray(linear), quality="high", **auxiliaries)
    picture = np.asarray(clean, dtype=np.float32)
    require_finite(picture, "denoising the picture", "relight without it (--no-denoise)")
    return np.clip(picture, 0.0, 1.0)


@contextmanager
def _without_torch() -> Iterator[None]:
    """Keep the binding from importing torch where it happens to be installed: it takes a second."""
    if "torch" in sys.modules:
        yield
        return
    sys.modules["torch"] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        if sys.modules.get("torch", sys) is None:  # another thread may have come first
            sys.modules.pop("torch", None)
