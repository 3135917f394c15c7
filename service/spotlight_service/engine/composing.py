"""A scene of an uploaded photograph and an uploaded object."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from spotlight_runtime import write_image
from spotlight_runtime.composing.backdrop import build_backdrop, combine_maps
from spotlight_runtime.composing.compose import compose, draft
from spotlight_runtime.composing.cutout import Cutout, estimate_cutout, read_cutout
from spotlight_runtime.composing.estimator import DETAIL_SIDE, estimate_intrinsics
from spotlight_runtime.composing.photograph import read_photograph
from spotlight_runtime.composing.posing import Placement
from spotlight_runtime.composing.product import Product
from spotlight_runtime.composing.product_files import load_product
from spotlight_runtime.networks.models import open_networks, resolve_model
from spotlight_runtime.networks.sessions import Network
from spotlight_runtime.scenes.bundle import save_bundle
from spotlight_service.engine.uploads import check_picture, kind_of, model_suffix
from spotlight_service.problems import FieldError

__all__ = ["compose_upload"]

ESTIMATOR: Final = "mini"
GRAPH: Final = "intrinsics"


def compose_upload(
    parts: Mapping[str, Path], fields: Mapping[str, Any], target: Path, most_pixels: int
) -> str:
    """Put an uploaded object into an uploaded photograph.

    Parameters
    ----------
    parts : mapping of str to Path
        ``photo``, ``object`` and, for a cut-out without transparency, ``mask``.
    fields : mapping
        As `spotlight_service.schemas.ComposeFields` has them.
    target : Path
        Scene folder to write.
    most_pixels : int
        Of any picture.

    Returns
    -------
    str
        What was found and made, for a person.

    Raises
    ------
    SpotLightError, FieldError
    """
    named = {name: _named(name, path, most_pixels) for name, path in parts.items()}
    photograph = read_photograph(named["photo"], fields["fov"])
    item = _item(named["object"], named.get("mask"), fields["variant"])
    network = _estimator()
    point = (float(fields["at"][0]), float(fields["at"][1]))
    backdrop = build_backdrop(
        photograph,
        combine_maps({}, estimate_intrinsics(network, photograph)),
        estimated=True,
        contact=point,
        horizon=fields["horizon"],
        camera_height=fields["camera_height"],
    )
    if isinstance(item, Cutout):
        item = estimate_cutout(network, item)
    placement = Placement(point, fields["yaw"], fields["size"], fields["height"])
    scene = compose(backdrop, item, placement, occluded=fields["occlusion"])
    save_bundle(scene, target, photograph=photograph.file, working_side=DETAIL_SIDE)
    write_image(target / "preview.png", draft(scene))
    up = backdrop.ground.normal
    pitch = math.degrees(math.atan2(up[2], up[1]))
    return (
        f"the object covers {float(scene.object_mask.mean()):.1%} of the picture; floor by "
        f"{backdrop.source}, {-backdrop.ground.offset:.2f} m under a camera that looks "
        f"{'down' if pitch >= 0.0 else 'up'} {abs(pitch):.0f} degrees"
    )


def _named(field: str, path: Path, most_pixels: int) -> Path:
    """The upload under a name with the suffix that its content calls for."""
    data = path.read_bytes()
    if field == "object" and kind_of(data) is None:
        suffix = model_suffix(field, data)
    else:
        suffix = check_picture(field, data, most_pixels)
    return path.rename(path.with_name(f"{field}{suffix}"))


def _item(path: Path, mask: Path | None, variant: str | None) -> Product | Cutout:
    if kind_of(path.read_bytes()[:16]) is not None:
        if variant is not None:
            raise FieldError("variant", "none for a cut-out", variant)
        return read_cutout(path, mask)
    if mask is not None:
        raise FieldError("mask", "none for a 3-D model", "one")
    return load_product(path, variant)


def _estimator() -> Network:
    return open_networks(resolve_model(ESTIMATOR), verify_files=False)[GRAPH]
