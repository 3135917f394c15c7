"""Networks that remember what they answered."""

from collections import Counter

import numpy as np

from spotlight_bench.remembered import Memory


class Doubler:
    """Counts how often it is asked."""

    def __init__(self):
        self.calls = Counter()

    def __call__(self, **inputs):
        self.calls[tuple(sorted(inputs))] += 1
        return {"answer": 2 * next(iter(inputs.values()))}

    @property
    def total(self):
        return sum(self.calls.values())


def test_the_same_question_is_asked_once_to_the_bit():
    doubler = Doubler()
    asked = Memory().networks({"vae_encoder": doubler})["vae_encoder"]
    x = np.arange(6, dtype=np.float32).reshape(2, 3)
    first, second = asked(image=x), asked(image=x.copy())
    np.testing.assert_array_equal(first["answer"], 2 * x)
    np.testing.assert_array_equal(second["answer"], 2 * x)
    assert doubler.total == 1
    nearly = x.copy()
    nearly[0, 0] = np.nextafter(np.float32(0), np.float32(1))
    for other in (nearly, x.astype(np.float64), x.reshape(3, 2), x.T):
        asked(image=other)
    asked(latents=x)
    assert doubler.total == 6


def test_an_answer_that_its_caller_changes_is_remembered_as_it_was():
    asked = Memory().networks({"unet": Doubler()})["unet"]
    x = np.ones(3, np.float32)
    asked(image=x)["answer"][:] = -1.0
    np.testing.assert_array_equal(asked(image=x)["answer"], 2 * x)


def test_networks_do_not_answer_for_each_other():
    one, other = Doubler(), Doubler()
    networks = Memory().networks({"one": one, "other": other})
    networks["one"](image=np.ones(1))
    networks["other"](image=np.ones(1))
    assert (one.total, other.total) == (1, 1)


def test_what_was_not_asked_for_the_longest_is_forgotten_first():
    doubler = Doubler()
    asked = Memory(most_bytes=2 * 80).networks({"unet": doubler})["unet"]
    a, b, c = (np.full(10, value) for value in (1.0, 2.0, 3.0))
    for question in (a, b, a, c, a):
        asked(image=question)
    assert doubler.total == 3
    asked(image=b)
    assert doubler.total == 4


def test_an_answer_larger_than_the_memory_is_still_given():
    asked = Memory(most_bytes=8).networks({"unet": Doubler()})["unet"]
    for value in (1.0, 2.0):
        np.testing.assert_array_equal(asked(image=np.full(10, value))["answer"], 2 * value)


def test_clearing_forgets():
    doubler, memory = Doubler(), Memory()
    asked = memory.networks({"unet": doubler})["unet"]
    asked(image=np.ones(1))
    memory.clear()
    asked(image=np.ones(1))
    assert doubler.total == 2


def test_controlnet_and_unet_become_one_denoiser():
    def controlnet(latents, timestep, condition):
        return {"residual": latents + condition}

    def unet(latents, timestep, residual):
        return {"prediction": latents * timestep + residual}

    networks = Memory().networks({"controlnet": controlnet, "unet": unet, "vae_decoder": Doubler()})
    assert set(networks) == {"denoiser", "vae_decoder"}
    z = np.ones((1, 2))
    answer = networks["denoiser"](latents=z, timestep=np.array([3]), condition=10 * z)
    np.testing.assert_array_equal(answer["prediction"], 14 * z)
