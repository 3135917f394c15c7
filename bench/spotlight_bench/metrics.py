"""How far a picture is from the truth, on the whole, on the object and on the background.

Every figure is of sRGB-encoded pictures in [0, 1] and comes from a library: PSNR, SSIM and the mean
squared error behind RMSE from scikit-image, ST-LPIPS from stlpips-pytorch, ꟻLIP from NVIDIA's
flip-evaluator; MAE is a mean of absolute differences.

Three regions: ``full``; ``foreground``, where the object covers at least half of a pixel;
``background``, the rest. A region's figure depends on the picture's pixels of that region alone.
For PSNR, RMSE and MAE that is a matter of course. SSIM, ST-LPIPS and ꟻLIP look at neighbourhoods
(ST-LPIPS at a third of the picture: a missing shadow would count against the object, and a wrong
object against the photograph), so they are taken of the picture with the truth put outside the
region, as maps, and averaged over the region; averaged over the whole picture, small objects would
look better than large ones. Means of the whole picture are what the libraries call their score:
exactly for SSIM and ꟻLIP, within 2e-5 of the value for ST-LPIPS.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity

from spotlight_runtime.arrays import BoolArray, FloatArray

__all__ = [
    "METRICS",
    "REGIONS",
    "Metric",
    "background_change",
    "flip_map",
    "isolated",
    "regions",
    "scores",
]

REGIONS: Final = ("full", "foreground", "background")
HALF_COVERED: Final = 0.5
BEST_PSNR: Final = 100.0
"""dB; equal pictures have no finite PSNR, and a table no infinite mean."""
SSIM_BORDER: Final = 3
"""Half of scikit-image's 7×7 window: nearer to the border the map is not of whole windows."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A column of the tables."""

    name: str
    label: str
    higher_is_better: bool
    digits: int

    @property
    def heading(self) -> str:
        """Label with the direction of better."""
        return f"{self.label}{'↑' if self.higher_is_better else '↓'}"


METRICS: Final = (
    Metric("psnr", "PSNR", True, 2),
    Metric("ssim", "SSIM", True, 3),
    Metric("rmse", "RMSE", False, 3),
    Metric("mae", "MAE", False, 3),
    Metric("st_lpips", "ST-LPIPS", False, 3),
    Metric("flip", "ꟻLIP", False, 3),
)


def regions(object_mask: FloatArray) -> dict[str, BoolArray]:
    """Pixels of each region, by name.

    Parameters
    ----------
    object_mask : ndarray of float32, shape (H, W)
        In [0, 1].
    """
    foreground = object_mask >= HALF_COVERED
    return {
        "full": np.ones_like(foreground),
        "foreground": foreground,
        "background": ~foreground,
    }


def isolated(
    picture: FloatArray, truth: FloatArray, masks: dict[str, BoolArray]
) -> dict[str, FloatArray]:
    """The picture with the truth put outside each region, by region; empty regions are left out.

    Parameters
    ----------
    picture, truth : ndarray of float32, shape (H, W, 3)
    masks : dict of ndarray of bool, shape (H, W)
        See `regions`.
    """
    return {
        name: np.where(mask[..., None], picture, truth)
        for name, mask in masks.items()
        if mask.any()
    }


def scores(
    pictures: dict[str, FloatArray],
    truth: FloatArray,
    masks: dict[str, BoolArray],
    lpips_maps: dict[str, FloatArray],
) -> dict[str, dict[str, float | None]]:
    """Every metric of every region.

    Parameters
    ----------
    pictures : dict of ndarray of float32, shape (H, W, 3)
        See `isolated`; sRGB-encoded, in [0, 1].
    truth : ndarray of float32, shape (H, W, 3)
    masks : dict of ndarray of bool, shape (H, W)
        See `regions`.
    lpips_maps : dict of ndarray of float32, shape (H, W)
        By region, from `spotlight_bench.perceptual`; may be empty.

    Returns
    -------
    dict
        By region and metric; None where there is none.
    """
    result: dict[str, dict[str, float | None]] = {}
    for name, mask in masks.items():
        if name not in pictures:
            result[name] = {metric.name: None for metric in METRICS}
            continue
        picture = pictures[name]
        maps = {"ssim": _ssim_map(picture, truth), "flip": flip_map(picture, truth)}
        if name in lpips_maps:
            maps["st_lpips"] = lpips_maps[name]
        result[name] = _pixel_scores(picture[mask], truth[mask]) | {
            metric: _mean(errors[mask]) for metric, errors in maps.items()
        }
        result[name].setdefault("st_lpips", None)
    return result


def flip_map(picture: FloatArray, truth: FloatArray) -> FloatArray:
    """ꟻLIP error of each pixel, float32, shape (H, W), at the library's 67 pixels a degree."""
    import flip_evaluator

    reference, test = (np.ascontiguousarray(image, dtype=np.float32) for image in (truth, picture))
    errors, _, _ = flip_evaluator.evaluate(
        reference, test, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False
    )
    return np.asarray(errors[..., 0])


def background_change(
    picture: FloatArray, photograph: FloatArray, object_mask: FloatArray, shadow: FloatArray
) -> float | None:
    """Largest change of the photograph where neither object nor shadow reach.

    Parameters
    ----------
    picture, photograph : ndarray of float32, shape (H, W, 3)
        sRGB-encoded.
    object_mask, shadow : ndarray of float32, shape (H, W)

    Returns
    -------
    float or None
        In [0, 1]; None where object and shadow leave nothing.
    """
    import cv2

    from spotlight_runtime.diffusion.conditioning import masked_region
    from spotlight_runtime.relighting.composite import REGION_BLUR

    touched = masked_region(shadow * (1.0 - object_mask), object_mask).astype(np.uint8)
    reach = np.ones((REGION_BLUR, REGION_BLUR), np.uint8)
    outside = cv2.dilate(touched, reach) == 0
    return float(np.abs(picture - photograph)[outside].max()) if outside.any() else None


def _ssim_map(picture: FloatArray, truth: FloatArray) -> FloatArray:
    _, similarity = structural_similarity(truth, picture, data_range=1.0, channel_axis=2, full=True)
    inner = np.full(truth.shape[:2], np.nan)
    keep = np.s_[SSIM_BORDER:-SSIM_BORDER, SSIM_BORDER:-SSIM_BORDER]
    inner[keep] = similarity.mean(axis=2)[keep]
    return inner


def _pixel_scores(picture: FloatArray, truth: FloatArray) -> dict[str, float | None]:
    wanted, got = truth.astype(np.float64), picture.astype(np.float64)
    error = float(mean_squared_error(wanted, got))
    equal = error <= 10.0 ** (-BEST_PSNR / 10.0)
    return {
        "psnr": BEST_PSNR if equal else float(peak_signal_noise_ratio(wanted, got, data_range=1.0)),
        "rmse": error**0.5,
        "mae": float(np.abs(wanted - got).mean()),
    }


def _mean(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean(dtype=np.float64)) if known.size else None
