"""What a closed loop answers to a step that is held on one of its inputs, however long that takes.

A held input is a state that stays, so many samples together are one matrix product, exact. The first samples are all
told; from there on blocks of consecutive ones, with gaps between them that grow with the time that has passed, so that
a loop a million samples slow is told like any other.
"""

from __future__ import annotations

import numpy as np

from emps_design.control.loop.sampled_loop import OUTPUTS, SampledLoop

BLOCK = 64  # consecutive samples, and at least a cycle
EVERY = 20_000  # samples from the start on that are all told
BLOCKS = 128  # so many of them at least, where a cycle makes them long


def step_answer(loop: SampledLoop, by: str, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples k (m,), outputs (m, 4) at them and position [m] at their ends after a unit step of ``by`` from rest.

    ``samples`` is how far that goes: up to :data:`EVERY` all of them are told. ``loop`` is a single one.

    >>> A, B, C = np.array([[0.5]]), np.array([[1.0]]), np.ones((4, 1))
    >>> k, found, _ = step_answer(SampledLoop(A, B, C, np.zeros((4, 1)), 1e-3, ("reference",)), "reference", 4)
    >>> k.tolist(), found[:, 0].tolist()
    ([0, 1, 2, 3], [0.0, 1.0, 1.5, 1.75])
    """
    moves, told = _with_the_step(loop, loop.inputs.index(by))
    length = loop.cycle * -(-BLOCK // loop.cycle)
    block, rows = np.eye(moves.shape[-1]), np.empty((length, *told.shape[1:]))
    for j in range(length):
        rows[j] = told[j % loop.cycle] @ block
        block = moves[j % loop.cycle] @ block
    starts, states = _blocks(block, -(-samples // length), max(-(-EVERY // length), BLOCKS))
    k = (length * starts[:, None] + np.arange(length)).ravel()
    found = np.tensordot(states, rows, axes=(1, 2)).reshape(k.size, -1)
    within = k < samples
    return k[within], found[within, :-1], found[within, -1]


def _with_the_step(loop: SampledLoop, place: int) -> tuple[np.ndarray, np.ndarray]:
    """By sample of a cycle: how the state moves, of which the last two are the position and the step; what is told."""
    A, b, C, d = loop.A, loop.B[..., place], loop.C, loop.D[..., place]
    if loop.cycle == 1:
        A, b, C, d = A[None], b[None], C[None], d[None]
    size, mean = A.shape[-1], OUTPUTS.index("mean_velocity")
    told = np.zeros((loop.cycle, len(OUTPUTS) + 1, size + 2))
    told[:, :-1, :size], told[:, :-1, -1] = C, d
    told[:, -1] = loop.period * told[:, mean]
    told[:, -1, size] = 1.0
    moves = np.zeros((loop.cycle, size + 2, size + 2))
    moves[:, :size, :size], moves[:, :size, -1], moves[:, -1, -1] = A, b, 1.0
    moves[:, size] = told[:, -1]
    return moves, told


def _blocks(block: np.ndarray, count: int, every: int) -> tuple[np.ndarray, np.ndarray]:
    """Which of ``count`` blocks are told, (m,), ``every`` so many first ones and then half as many for each doubling of
    the time; and the states at their beginnings (m, n)."""
    state, gap, at, left = np.eye(len(block))[-1], 1, 0, every
    starts, states = [], []
    while at < count:
        starts.append(at)
        states.append(state)
        state, at, left = block @ state, at + gap, left - 1
        if not left:
            block, gap, left = block @ block, 2 * gap, every // 2
    return np.array(starts), np.array(states)
