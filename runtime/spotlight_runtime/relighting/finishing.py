"""From the renderer's pictures to the relit photograph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.colour import decode_to_linear, linear_to_srgb
from spotlight_runtime.planning.options import RelightOptions
from spotlight_runtime.relighting.layers import Layer, frame_layer, window_layer
from spotlight_runtime.relighting.preparation import Prepared
from spotlight_runtime.relighting.putback import put_back
from spotlight_runtime.relighting.result import RelightResult
from spotlight_runtime.relighting.tasks import Task
from spotlight_spec import BackboneSpec

__all__ = ["layer", "result"]


def layer(
    spec: BackboneSpec,
    prepared: Prepared,
    number: int,
    predicted: FloatArray,
    no_shadow: FloatArray,
    options: RelightOptions,
) -> Layer:
    """What one light's predictions make of the photograph.

    Parameters
    ----------
    spec : BackboneSpec
    prepared : Prepared
    number : int
        Which of its lights.
    predicted, no_shadow : ndarray of float32, shape (h, w, 3)
        As `develop` returns them.
    options : RelightOptions
        ``fidelity``, ``detail`` and ``gamma`` apply.

    Returns
    -------
    Layer
    """
    shadow, _ = prepared.shadows[number]
    canvas, view = prepared.canvas, prepared.view
    fidelity = options.fidelity
    believed = options.detail == "renderer" or (options.detail == "auto" and not spec.light_reach)
    if prepared.window.native and believed:
        return frame_layer(spec, canvas.size, view, shadow, predicted, no_shadow, fidelity)
    return window_layer(
        spec,
        canvas,
        prepared.window,
        prepared.guides[number].positive,
        view,
        shadow,
        predicted,
        no_shadow,
        fidelity,
        options.gamma,
    )


def result(
    spec: BackboneSpec,
    task: Task,
    predicted: Sequence[FloatArray],
    no_shadow: FloatArray,
    model: dict[str, Any],
) -> RelightResult:
    """Put the predictions of all lights back into the photograph.

    Parameters
    ----------
    spec : BackboneSpec
    task : Task
    predicted : sequence of ndarray of float32, shape (h, w, 3)
        As `develop` returns them, one a light.
    no_shadow : ndarray of float32, shape (h, w, 3)
        Likewise, of the pass without shadow.
    model : dict
        Facts about the model.

    Returns
    -------
    RelightResult
    """
    prepared = task.prepared
    with task.stopwatch.stage("composite"):
        layers = [
            layer(spec, prepared, number, picture, no_shadow, task.options)
            for number, picture in enumerate(predicted)
        ]
        image = put_back(prepared.canvas, prepared.window, layers, prepared.mix)
    height, width = prepared.window.size

    def shown(linear: FloatArray) -> FloatArray:
        return linear_to_srgb(linear[:height, :width])

    lit = [decode_to_linear(picture, spec.image_encoding) for picture in predicted]
    return RelightResult(
        image=image,
        prediction=shown(prepared.mix.sum(lit)),
        no_shadow=shown(decode_to_linear(no_shadow, spec.image_encoding)),
        options=task.options,
        plan=task.plan,
        timings=dict(task.stopwatch.seconds),
        denoised=task.denoised,
        window=prepared.window,
        guides=prepared.guides,
        model=model,
    )
