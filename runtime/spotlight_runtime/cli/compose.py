"""``spotlight compose``."""

from __future__ import annotations

import math
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Final

import typer

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing.backdrop import (
    CAMERA_HEIGHT,
    NEEDED,
    Backdrop,
    build_backdrop,
    combine_maps,
    read_map,
)
from spotlight_runtime.composing.compose import compose as compose_scene
from spotlight_runtime.composing.compose import draft
from spotlight_runtime.composing.cutout import Cutout, estimate_cutout, read_cutout
from spotlight_runtime.composing.estimator import DETAIL_SIDE, estimate_intrinsics
from spotlight_runtime.composing.photograph import (
    SMALLEST_SIDE,
    Photograph,
    crop_panorama,
    expose,
    horizon_of,
    read_photograph,
)
from spotlight_runtime.composing.posing import Placement
from spotlight_runtime.composing.product import Product
from spotlight_runtime.composing.product_files import PRODUCT_SUFFIXES, load_product
from spotlight_runtime.errors import InvalidInputError, MissingMapError
from spotlight_runtime.geometry.camera import DEFAULT_FIELD_OF_VIEW, Camera
from spotlight_runtime.imaging.headers import MAX_PIXELS
from spotlight_runtime.imaging.images import check_target
from spotlight_runtime.imaging.picture_files import write_picture
from spotlight_runtime.networks.models import open_networks, resolve_model
from spotlight_runtime.networks.sessions import Network
from spotlight_runtime.scenes.bundle import save_bundle
from spotlight_runtime.scenes.scene import Scene

__all__ = ["compose"]


ESTIMATOR_GRAPH: Final = "intrinsics"
CROP: Final = "640x480"
_View = tuple[float, float, Camera]
"""Yaw and pitch of a look into a panorama, and the camera that takes it."""
_RANGES: Final = {
    "--size": ("metres", 1e-6, 1e6),
    "--height": ("metres", 1e-6, 1e6),
    "--fov": ("degrees", 1.0, 179.0),
    "--exposure": ("stops", -30.0, 30.0),
    "--horizon": ("a fraction of the height", -100.0, 100.0),
    "--camera-height": ("a camera height in metres", 1e-6, 1e6),
    "--depth-scale": ("metres", 1e-6, 1e6),
    "--panorama YAW": ("degrees", -3600.0, 3600.0),
    "--panorama PITCH": ("degrees", -89.0, 89.0),  # straight up there is no horizon
}
"""In what unit a number is given, and between which bounds it makes sense."""


def compose(
    background: Annotated[
        Path, typer.Option(help="Photograph: PNG, JPEG, WebP, or linear HDR, EXR.")
    ],
    item: Annotated[
        Path,
        typer.Option(
            "--object", help="3-D model (.glb, .gltf, .obj), or a picture of the object cut out."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Scene folder to write.")],
    at: Annotated[
        str,
        typer.Option(
            metavar="X,Y",
            help="Where the middle of its underside touches the floor: fractions of the picture "
            "or pixels, from the upper left.",
        ),
    ] = "0.5,0.8",
    yaw: Annotated[
        float, typer.Option(help="Turn, in degrees counter-clockwise seen from above.")
    ] = 0.0,
    size: Annotated[
        float | None,
        typer.Option(help="Longest side in metres.", show_default="the model's own"),
    ] = None,
    height: Annotated[float | None, typer.Option(help="Instead, the height in metres.")] = None,
    variant: Annotated[str | None, typer.Option(help="Which of a glTF's variants.")] = None,
    mask: Annotated[
        Path | None, typer.Option(help="Of a cut-out without alpha: white on the object.")
    ] = None,
    occlusion: Annotated[
        bool | None,
        typer.Option(
            "--occlusion/--no-occlusion",
            help="Let what stands nearer in the photograph hide the object.",
            show_default="where --depth says what is nearer",
        ),
    ] = None,
    fov: Annotated[
        float | None,
        typer.Option(
            help="Horizontal field of view, degrees.",
            show_default=f"EXIF, {DEFAULT_FIELD_OF_VIEW:g}",
        ),
    ] = None,
    panorama: Annotated[
        str | None,
        typer.Option(
            metavar="YAW,PITCH",
            help="The background is an equirectangular panorama: look that many degrees to the "
            "right of its middle and above its horizon.",
        ),
    ] = None,
    crop: Annotated[
        str | None,
        typer.Option(
            metavar="WxH", help="Size in pixels of the view of a panorama.", show_default=CROP
        ),
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option(
            help="Stops to brighten the background by.", show_default="HDR and EXR: to fit"
        ),
    ] = None,
    horizon: Annotated[
        float | None,
        typer.Option(
            help="Row of the horizon, as a fraction of the height; with --at it places the floor.",
            show_default="the floor is found by upright edges, or depth",
        ),
    ] = None,
    camera_height: Annotated[
        float | None,
        typer.Option(
            help="Metres from the floor to the camera, which give the depth its scale.",
            show_default=f"{CAMERA_HEIGHT}, or what --depth says",
        ),
    ] = None,
    albedo: Annotated[Path | None, typer.Option(help="The background's albedo.")] = None,
    normal: Annotated[Path | None, typer.Option(help="The background's normals.")] = None,
    depth: Annotated[Path | None, typer.Option(help="The background's depth.")] = None,
    depth_scale: Annotated[
        float, typer.Option(help="Metres per unit of the depth map; 65.535 for millimetres in PNG.")
    ] = 1.0,
    roughness: Annotated[Path | None, typer.Option(help="The background's roughness.")] = None,
    metallic: Annotated[Path | None, typer.Option(help="The background's metalness.")] = None,
    estimator: Annotated[
        str, typer.Option(help="Model that estimates what maps are not given.")
    ] = "mini",
    preview: Annotated[
        Path | None,
        typer.Option(help="Quick look at the scene.", show_default="preview.png in the scene"),
    ] = None,
) -> None:
    """Put an object into a photograph: what comes out is a scene to relight.

    Example: spotlight compose --background room.jpg --object chair.glb --at 0.5,0.8 --yaw 30
    --size 0.9 -o chair-in-room/
    """
    if preview is not None:
        check_target(preview)
    for option, value in (
        ("--size", size),
        ("--height", height),
        ("--fov", fov),
        ("--exposure", exposure),
        ("--horizon", horizon),
        ("--camera-height", camera_height),
        ("--depth-scale", depth_scale),
    ):
        _check(option, value)
    view = _view(panorama, crop, fov)
    with ThreadPoolExecutor(1) as aside:
        pending = aside.submit(_object, item, variant, mask)
        photograph, level = _photograph(background, fov, exposure, view)
        point = _pair("--at", at)
        if max(point) > 1.0:
            point = (point[0] / photograph.size[1], point[1] / photograph.size[0])
        placement = Placement(point, yaw, size, height)
        paths = {
            "albedo": albedo,
            "normal": normal,
            "depth": depth,
            "roughness": roughness,
            "metallic": metallic,
        }
        given: dict[str, FloatArray] = {
            name: read_map(path, name, photograph.size, depth_scale)
            for name, path in paths.items()
            if path is not None
        }
        guessed = [name for name in NEEDED if name not in given]
        backdrop = build_backdrop(
            photograph,
            # Not named here: a large photograph's maps before its floor is known go with it.
            combine_maps(
                given, estimate_intrinsics(_estimator(estimator), photograph) if guessed else None
            ),
            estimated=depth is None,
            contact=point,
            horizon=level if horizon is None else horizon,
            camera_height=camera_height,
        )
        thing = pending.result()
    if isinstance(thing, Cutout):
        thing = estimate_cutout(_estimator(estimator), thing)
    hides = depth is not None if occlusion is None else occlusion
    scene = compose_scene(backdrop, thing, placement, occluded=hides)
    with ThreadPoolExecutor(1) as aside:
        look = aside.submit(draft, scene)
        save_bundle(
            scene,
            output,
            photograph=photograph.file,
            working_side=DETAIL_SIDE,
            estimated=guessed,
        )
    write_picture(output / "preview.png" if preview is None else preview, look.result())
    print(f"{output}: {_account(backdrop, scene)}", file=sys.stderr)


def _account(backdrop: Backdrop, scene: Scene) -> str:
    """What was found and made, and how to correct it."""
    up = backdrop.ground.normal
    pitch = math.degrees(math.atan2(up[2], up[1]))
    row = horizon_of(backdrop.photograph.camera, -pitch)
    return (
        f"the object covers {float(scene.object_mask.mean()):.1%} of the picture; floor by "
        f"{backdrop.source}, {-backdrop.ground.offset:.2f} m under a camera that looks "
        f"{'down' if pitch >= 0.0 else 'up'} {abs(pitch):.0f} degrees (this is --horizon {row:.2f})"
    )


def _check(option: str, value: float | None) -> None:
    what, low, high = _RANGES[option]
    if value is not None and not low <= value <= high:  # NaN is not, either
        raise InvalidInputError(
            f"{option}: expected {what} from {low:g} to {high:g}, got {value:g}"
        )


def _view(panorama: str | None, crop: str | None, fov: float | None) -> _View | None:
    """What is seen of a panorama."""
    if panorama is None:
        if crop is not None:
            raise InvalidInputError("--crop: expected --panorama beside it, say --panorama 0,0")
        return None
    yaw, pitch = _pair("--panorama", panorama)
    _check("--panorama YAW", yaw)
    _check("--panorama PITCH", pitch)
    try:
        width, height = (int(side) for side in (CROP if crop is None else crop).split("x"))
    except ValueError:
        width = height = 0
    if min(width, height) < SMALLEST_SIDE or width * height > MAX_PIXELS:
        raise InvalidInputError(
            f"--crop: expected width x height such as {CROP}, sides of at least {SMALLEST_SIDE} "
            f"pixels and at most {MAX_PIXELS // 1_000_000} megapixels, got {crop!r}"
        )
    camera = Camera(width, height, DEFAULT_FIELD_OF_VIEW if fov is None else fov)
    return yaw, pitch, camera


def _photograph(
    path: Path, fov: float | None, exposure: float | None, view: _View | None
) -> tuple[Photograph, float | None]:
    """The photograph, and the row of its horizon where a panorama gives it."""
    if view is None:
        return read_photograph(path, fov, exposure), None
    yaw, pitch, camera = view
    seen = crop_panorama(read_photograph(path, exposure=exposure or 0.0), yaw, pitch, camera)
    if exposure is None:
        seen = Photograph(expose(seen.radiance), seen.field_of_view, seen.name)
    return seen, horizon_of(camera, pitch)


def _object(path: Path, variant: str | None, mask: Path | None) -> Product | Cutout:
    if path.suffix.lower() not in PRODUCT_SUFFIXES:
        if variant is not None:
            raise InvalidInputError("--variant: a cut-out has none; leave it out")
        return read_cutout(path, mask)
    if mask is not None:
        raise InvalidInputError("--mask: a 3-D model needs none; leave it out")
    return load_product(path, variant)


def _estimator(model: str) -> Network:
    folder = resolve_model(model)
    names = [graph.name for graph in folder.manifest.graphs]
    if ESTIMATOR_GRAPH not in names:
        raise MissingMapError(
            f"estimator {model!r}: expected a model with the graph {ESTIMATOR_GRAPH!r}, which "
            f"estimates maps, got one with {', '.join(names)}; name another (--estimator), or "
            "give --albedo, --normal and --depth"
        )
    return open_networks(folder)[ESTIMATOR_GRAPH]


def _pair(option: str, text: str) -> tuple[float, float]:
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInputError(
            f"{option}: expected two numbers with a comma between, got {text!r}"
        ) from None
    return first, second
