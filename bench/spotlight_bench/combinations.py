"""Real photographs and products, put together and relit by the commands a person would type."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from spotlight_bench.errors import DataError
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.images import read_image, write_image
from spotlight_runtime.relighting.sweep import Tile, contact_sheet

__all__ = ["COMBINATIONS", "Combination", "combine"]

TILE: Final = (384, 512)
"""Height and width of a picture on the sheet."""


@dataclass(frozen=True, slots=True)
class Combination:
    """One photograph, one product, one light.

    Attributes
    ----------
    name : str
        Of its folder and files.
    background, product : str
        Below the folder of real inputs; or a file `_drawn` makes.
    compose, relight : str
        Further arguments of ``spotlight compose`` and ``spotlight relight``.
    """

    name: str
    background: str
    product: str
    compose: str
    relight: str


COMBINATIONS: Final = (
    Combination(
        "armchair",
        "hdr/empty_warehouse_01_1k.hdr",
        "models/kaykit_armchair_pillows/armchair_pillows.gltf",
        "--panorama 20,-18 --fov 60 --crop 1024x768 --at 0.45,0.78 --yaw 30 --height 0.9",
        "--azimuth 160 --elevation 40",
    ),
    Combination(
        "stool-in-photograph",
        "photos/demo10.jpg",
        "models/ph_painted_wooden_stool_1k/painted_wooden_stool_1k.gltf",
        "--at 0.91,0.93 --yaw 20 --horizon 0.35",
        "--azimuth 140 --elevation 50",
    ),
    Combination(
        "sofa-two-lights",
        "hdr/st_fagans_interior_1k.hdr",
        "models/GlamVelvetSofa/GlamVelvetSofa.gltf",
        "--panorama 180,-22 --fov 65 --crop 1024x768 --at 0.5,0.8 --yaw 20 --variant Champagne",
        "--lights {two}",
    ),
    Combination(
        "bottle-metal",
        "hdr/lab.hdr",
        "models/WaterBottle/WaterBottle.gltf",
        "--panorama 0,-30 --fov 60 --crop 1024x768 --at 0.5,0.8 --height 0.6",
        "--azimuth 30 --elevation 35",
    ),
    Combination(
        "cabinet-scribble",
        "hdr/workshop.hdr",
        "models/kaykit_cabinet_medium_decorated/cabinet_medium_decorated.gltf",
        "--panorama 30,-18 --fov 60 --crop 1024x768 --at 0.55,0.75 --yaw 15 --height 1.1",
        "--shadow {scribble} --softness 6",
    ),
    Combination(
        "cup-cut-out",
        "hdr/empty_warehouse_01_1k.hdr",
        "{cup}",
        "--panorama 200,-25 --fov 50 --crop 1024x768 --at 0.5,0.85 --height 0.6",
        "--azimuth 200 --elevation 45",
    ),
    Combination(
        "stool-in-the-sun",
        "hdr/rooitou_park_1k.hdr",
        "models/ph_painted_wooden_stool_1k/painted_wooden_stool_1k.gltf",
        "--panorama 120,-18 --fov 60 --crop 1024x768 --at 0.5,0.8 --yaw 35",
        "--azimuth 200 --elevation 30 --directional --radius 0.5",
    ),
)


def combine(
    inputs: Path, out: Path, further: list[str], chosen: list[str]
) -> Iterator[tuple[str, Path]]:
    """Run the commands of all combinations, and lay the pictures out on ``out/sheet.png``.

    Parameters
    ----------
    inputs : Path
        Folder of the real inputs.
    out : Path
        Folder for scenes, pictures and the sheet.
    further : list of str
        Arguments for every ``spotlight relight``.
    chosen : list of str
        Names of combinations; empty for all.

    Yields
    ------
    command : str
        As it is about to be run.
    picture : Path
        That it makes.

    Raises
    ------
    DataError
        If an input is missing or a command fails.
    """
    out.mkdir(parents=True, exist_ok=True)
    drawn = _drawn(inputs, out)
    tiles = []
    for each in COMBINATIONS:
        if chosen and each.name not in chosen:
            continue
        scene, pasted = out / each.name, out / f"{each.name}-pasted.png"
        picture, shadow = out / f"{each.name}.png", out / f"{each.name}-shadow.png"
        product = each.product.format(**drawn)
        product = product if Path(product).is_absolute() else str(inputs / product)
        compose = ["compose", "--background", str(inputs / each.background), "--object", product]
        compose += [*shlex.split(each.compose), "-o", str(scene), "--preview", str(pasted)]
        relight = ["relight", str(scene), *shlex.split(each.relight.format(**drawn)), *further]
        relight += ["-o", str(picture), "--shadow-out", str(shadow)]
        for arguments, made in ((compose, pasted), (relight, picture)):
            yield "spotlight " + shlex.join(arguments), made
            _run(arguments)
        for path, caption in (
            (pasted, f"{each.name}: as composed"),
            (shadow, "guiding shadow"),
            (picture, "relit"),
        ):
            tiles.append(_tile(path, caption))
    write_image(out / "sheet.png", _sheet(tiles))


def _run(arguments: list[str]) -> None:
    start = "from spotlight_runtime.cli import main; main()"
    command = [sys.executable, "-c", start, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise DataError(f"spotlight {shlex.join(arguments)}: {done.stderr.strip()}")


def _drawn(inputs: Path, out: Path) -> dict[str, str]:
    """What no file holds: two lights, a scribble, and a cup cut out of its photograph."""
    photograph = inputs / "photos/coffee.png"
    if not photograph.is_file():
        raise DataError(f"{inputs}: expected the folder of real inputs, found no photos/coffee.png")
    paths = {name: out.resolve() / name for name in ("two.json", "scribble.png", "cup.png")}
    lights = [
        {"azimuth": 20, "elevation": 45, "weight": 1.0, "colour": [1.0, 0.85, 0.7]},
        {"azimuth": 160, "elevation": 35, "weight": 0.7, "colour": [0.7, 0.85, 1.0]},
    ]
    paths["two.json"].write_text(json.dumps(lights))
    scribble = np.zeros((192, 256), np.uint8)
    outline = np.array([[150, 150], [128, 132], [60, 140], [35, 156], [80, 168], [140, 164]])
    cv2.fillPoly(scribble, [outline], 255, cv2.LINE_AA)
    cv2.imwrite(str(paths["scribble.png"]), scribble)
    cup = cv2.imread(str(photograph))
    cover = np.zeros(cup.shape[:2], np.uint8)
    cv2.ellipse(cover, ((277, 230), (398, 314), 8), 255, -1, cv2.LINE_AA)
    cv2.ellipse(cover, ((279, 112), (218, 198), 0), 255, -1, cv2.LINE_AA)
    spoon = np.array([[398, 72], [410, 66], [423, 74], [422, 86], [400, 150], [385, 140]])
    cv2.fillPoly(cover, [spoon], 255, cv2.LINE_AA)
    cv2.imwrite(str(paths["cup.png"]), np.dstack([cup, cover]))
    return {path.stem: str(path) for path in paths.values()}


def _tile(path: Path, caption: str) -> Tile:
    picture = read_image(path)
    if picture.ndim == 2 or picture.shape[2] == 1:
        picture = np.repeat(picture.reshape(*picture.shape[:2], 1), 3, axis=2)
    shrunk = cv2.resize(picture[..., :3], TILE[::-1], interpolation=cv2.INTER_AREA)
    return Tile(np.asarray(shrunk, np.float32), caption)


def _sheet(tiles: list[Tile]) -> FloatArray:
    """Three pictures a row: composed, shadow, relit."""
    rows = [contact_sheet(tiles[i : i + 3]) for i in range(0, len(tiles), 3)]
    return np.concatenate(rows)
