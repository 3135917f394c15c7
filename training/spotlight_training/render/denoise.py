"""Cleans low-sample renders with Open Image Denoise."""

from __future__ import annotations

import numpy as np
import pyoidn

from .mesh import Array

QUALITIES = {
    "fast": pyoidn.OIDN_QUALITY_FAST,
    "balanced": pyoidn.OIDN_QUALITY_BALANCED,
    "high": pyoidn.OIDN_QUALITY_HIGH,
}


class Denoiser:
    """One Open Image Denoise device on the CPU, kept for a whole run.

    Parameters
    ----------
    threads : int, optional
        CPU threads; all of them if not given.
    quality : {'fast', 'balanced', 'high'}
        Size of the denoising network.
    """

    def __init__(self, threads: int | None = None, quality: str = "fast") -> None:
        if quality not in QUALITIES:
            raise ValueError(
                f"denoiser quality: expected one of {', '.join(QUALITIES)}; got {quality!r}."
            )
        self._quality = QUALITIES[quality]
        self._device = pyoidn.Device()
        if threads is not None:
            self._device.set_int("numThreads", threads)
            # Pinned, every process of a machine would queue for the same first cores.
            self._device.set_bool("setAffinity", False)
        self._device.commit()
        self._check()

    def radiance(self, noisy: Array, albedo: Array, normal: Array) -> Array:
        """Denoise linear radiance, guided by albedo and unit normals; all of shape (H, W, 3)."""
        return self._run(noisy, {"albedo": albedo, "normal": normal}, hdr=True)

    def fraction(self, noisy: Array) -> Array:
        """Denoise one plane in [0, 1], shape (H, W)."""
        return self._run(np.repeat(noisy[..., None], 3, axis=2), {}, hdr=False)[..., 0]

    def close(self) -> None:
        """Release the device."""
        self._device.release()

    def _run(self, colour: Array, guides: dict[str, Array], hdr: bool) -> Array:
        images = {
            name: np.ascontiguousarray(image, dtype=np.float32) for name, image in guides.items()
        }
        images["color"] = np.ascontiguousarray(colour, dtype=np.float32)
        images["output"] = np.empty_like(images["color"])
        with pyoidn.Filter(self._device) as task:
            for name, image in images.items():
                task.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
            task.set_bool("hdr", hdr)
            # Plain numbers need no decoding from sRGB; and sampled guides of flat surfaces have no
            # noise to keep out.
            task.set_bool("srgb", not hdr)
            task.set_bool("cleanAux", bool(guides))
            task.set_quality(self._quality)
            task.commit()
            task.execute()
            self._check()
        return images["output"]

    def _check(self) -> None:
        error = self._device.get_error()
        if error:
            raise RuntimeError(
                f"denoiser: Open Image Denoise reports {error!r}. Reinstall the package 'pyoidn'."
            )
