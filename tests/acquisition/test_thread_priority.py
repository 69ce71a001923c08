"""Real-time priority: taken where permitted, told where not."""

from __future__ import annotations

import os

import pytest

from acquisition.recording.thread_priority import raise_priority


def test_no_priority_leaves_the_thread_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_setscheduler")
    assert raise_priority(0) == ""


def test_the_calling_thread_becomes_a_real_time_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, how, p: asked.append((pid, how, p.sched_priority))
    )
    assert raise_priority(20) == ""
    assert asked == [(0, os.SCHED_FIFO, 20)]


def test_without_permission_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    text = raise_priority(20)
    assert "Operation not permitted" in text
    assert "LimitRTPRIO" in text
