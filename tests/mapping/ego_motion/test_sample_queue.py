"""Samples in whatever order, out in order of time."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mapping.ego_motion.sample_queue import SampleQueue

samples = st.lists(st.tuples(st.integers(0, 50), st.floats(-5, 5)), min_size=1, max_size=30)


@given(samples, st.randoms(use_true_random=False))
def test_the_order_of_arrival_does_not_matter(items: list[tuple[int, float]], random) -> None:  # type: ignore[no-untyped-def]  # hypothesis' Random has no public type
    def released(order: list[tuple[int, float]]) -> tuple[list[int], list[float]]:
        queue = SampleQueue(1)
        for t_ns, value in order:
            assert queue.add(t_ns, (value,))
        queue.release(40)
        return queue.t_ns.tolist(), queue.values[:, 0].tolist()

    shuffled = items.copy()
    random.shuffle(shuffled)
    times, _ = released(items)
    assert released(items) == released(shuffled)
    assert times == sorted({t for t, _ in items if t <= 40})


def test_what_comes_after_its_release_is_refused() -> None:
    queue = SampleQueue(1)
    queue.release(10)
    assert not queue.add(10, (1.0,))
    assert queue.add(11, (1.0,))


def test_values_between_samples_are_linear_and_tell_how_far_a_sample_is() -> None:
    queue = SampleQueue(1)
    for t_ns, value in ((0, 0.0), (10, 1.0), (100, 2.0)):
        queue.add(t_ns, (value,))
    queue.release(100)
    values, apart = queue.at(np.array([5, 40]))
    np.testing.assert_allclose(values[:, 0], [0.5, 1.0 + 30 / 90])
    assert apart.tolist() == [5, 30]
    queue.forget(50)
    assert queue.t_ns.tolist() == [10, 100]
    assert queue.between(10, 100)[0].tolist() == [100]


def test_an_empty_queue_is_far_from_everything() -> None:
    _, apart = SampleQueue(2).at(np.array([5]))
    assert apart[0] > 10**15
