"""A shadow is as dark in a few steps as in all of them."""

import numpy as np
import pytest

from spotlight_runtime import Relighter, Scene
from spotlight_runtime.cli.demo import SCENES
from spotlight_runtime.imaging.colour import linear_to_srgb

USUAL = {"denoise": False, "window": "frame"}


@pytest.fixture(scope="module")
def darkening():
    """How much darker than the photographs the ground of drawn shadows becomes, by options."""
    relighter = Relighter.load("mini", remember=0)

    def of(scene, options):
        rows, columns = np.nonzero(scene.object_mask > 0.5)
        foot, right = rows.max(), columns.max()
        shadow = np.zeros(scene.size, np.float32)
        shadow[foot - 24 : foot + 16, right - 40 : right + 60] = 1.0
        ground = (shadow > 0.0) & (scene.object_mask == 0.0)
        before = np.clip(linear_to_srgb(scene.background), 0.0, 1.0)[ground].mean()
        picture = relighter.relight(scene, shadow, **USUAL | options).image
        return 1.0 - picture[ground].mean() / before

    scenes = [Scene.load(folder) for folder in sorted(SCENES.iterdir())]
    return lambda **options: np.mean([of(scene, options) for scene in scenes])


@pytest.mark.parametrize(("solver", "steps"), [("ddim", 6), ("unipc", 3), ("dpmpp_2m", 2)])
def test_few_steps_put_in_as_much_shadow(darkening, solver, steps):
    whole = darkening()
    assert whole > 0.1
    assert darkening(solver=solver, steps=steps) == pytest.approx(whole, rel=0.15)


def test_the_release_does_not_weigh_steps(darkening):
    """So it has next to no shadow in two, which is why the paper's fidelity weighs them."""
    few = {"solver": "unipc", "steps": 2}
    assert darkening(fidelity="release", **few) < 0.3 * darkening(**few)
