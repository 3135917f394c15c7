"""One peer at work in a process of its own: evaluations, then whole relights, by the clock.

``python -m spotlight_bench.peers_worker WISH.json``; its answer is a JSON line on stdout, its
pictures and predictions NumPy files where the wish says.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from spotlight_bench.peers_engines import open_engine
from spotlight_runtime import GuidingShadow, Relighter, RelightOptions, RelightResult, Scene
from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.networks.models import release
from spotlight_runtime.relighting.calibration import made_up_scene
from spotlight_runtime.relighting.result import peak_memory_bytes
from spotlight_spec import BackboneSpec, Manifest

__all__ = ["evaluations", "main", "relight", "scene_of"]

TIMESTEPS: Final = (999, 600, 200)
"""What a run begins, goes through and ends with."""
SEED: Final = 0


def main(wish: dict[str, Any]) -> dict[str, Any]:
    """Measure one peer.

    Parameters
    ----------
    wish : dict
        ``engine source precision threads`` as `open_engine` takes them; ``spec``, a model folder
        whose backbone it is; ``side`` of the picture; ``evaluations`` to time; ``relights``, plans
        to run whole; ``output``, a folder for what came out; ``low_memory``, to hold only the
        session at work.

    Returns
    -------
    dict
        ``evaluation_seconds``, ``relight_seconds`` by plan, ``relight_evaluations`` by plan,
        ``load_seconds``, ``peak_memory_bytes``.
    """
    spec = Manifest.read(Path(wish["spec"])).backbone
    start = time.perf_counter()
    networks = open_engine(wish["engine"], Path(wish["source"]), wish["precision"], wish["threads"])
    predictions, seconds = evaluations(networks, spec, wish["side"], wish["evaluations"])
    loading = time.perf_counter() - start - sum(seconds)
    output = Path(wish["output"])
    output.mkdir(parents=True, exist_ok=True)
    np.save(output / "predictions.npy", predictions)
    answer: dict[str, Any] = {
        "evaluation_seconds": seconds,
        "load_seconds": loading,
        "relight_seconds": {},
        "relight_evaluations": {},
    }
    if wish["low_memory"]:
        release(networks, *networks)
    for plan in wish["relights"]:
        took, result = relight(
            networks, spec, wish["side"], plan, ours=wish["engine"] == "spotlight",
            batched=wish["engine"] == "torch", low_memory=wish["low_memory"],
        )  # fmt: skip
        answer["relight_seconds"][plan] = took
        answer["relight_evaluations"][plan] = result.evaluations
        np.save(output / f"relight_{plan}.npy", result.image)  # what plans diffuse of it differs
    return answer | {"peak_memory_bytes": peak_memory_bytes()}


def evaluations(
    networks: Mapping[str, Any], spec: BackboneSpec, side: int, count: int
) -> tuple[FloatArray, list[float]]:
    """One branch's evaluations on made-up latents and maps, after a first that is not counted.

    Returns
    -------
    predictions : ndarray of float32, shape (timesteps, C, h, w)
    seconds : list of float
        Of ``count`` evaluations.
    """
    rng = np.random.default_rng(SEED)
    small = side // spec.latent.downscale
    latents = rng.standard_normal((1, spec.latent.channels, small, small), np.float32)
    maps = rng.random((1, spec.conditioning_channels, side, side), np.float32)
    condition = networks["condition_encoder"](conditioning=maps)["condition"]

    def evaluate(timestep: int) -> tuple[FloatArray, float]:
        start = time.perf_counter()
        found = networks["denoiser"](
            latents=latents, timestep=np.array([timestep], np.int64), condition=condition
        )
        return found["prediction"][0], time.perf_counter() - start

    evaluate(TIMESTEPS[0])  # opens and compiles
    made = [evaluate(TIMESTEPS[number % len(TIMESTEPS)]) for number in range(count)]
    kept = np.stack([prediction for prediction, _ in made[: len(TIMESTEPS)]])
    return kept, [seconds for _, seconds in made]


def relight(
    networks: Mapping[str, Any],
    spec: BackboneSpec,
    side: int,
    plan: str,
    *,
    ours: bool,
    batched: bool,
    low_memory: bool = False,
) -> tuple[float, RelightResult]:
    """A whole relight: ``release`` is the public release's loop, others are our named plans.

    Parameters
    ----------
    networks : mapping of str to callable
    spec : BackboneSpec
    side : int
        Of the square photograph.
    plan : str
    ours : bool
        Leave out what the scene does not call for; the release never does.
    batched : bool
        Both branches in one call, as the release has it.
    low_memory : bool
        Hold only the session at work.

    Returns
    -------
    seconds : float
    result : RelightResult
    """
    scene, guide = scene_of(side)
    relighter = Relighter(spec, networks, remember=0, low_memory=low_memory)
    options = RelightOptions(denoise=False, batch_branches=batched)
    start = time.perf_counter()
    if plan == "release":
        result = relighter.relight(scene, guide, options=options, fidelity="release", skip=ours)
    else:
        result = relighter.relight(scene, guide, options=options, plan=plan)  # type: ignore[arg-type]
    return time.perf_counter() - start, result


def scene_of(side: int) -> tuple[Scene, GuidingShadow]:
    """A ball on a plain floor with its shadow to the right, contrasted with one to the left."""
    scene, right = made_up_scene(side)
    return scene, GuidingShadow(right, np.ascontiguousarray(right[:, ::-1]))


if __name__ == "__main__":
    print(json.dumps(main(json.loads(Path(sys.argv[1]).read_text()))))
