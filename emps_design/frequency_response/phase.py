"""What the phase of a response says before anything is fitted to it: how late the force comes, and with which sign."""

from __future__ import annotations

import numpy as np

from emps_design.frequency_response.response import FrequencyResponse

WEIGHED = 0.1  # relative deviation below which lines weigh alike: resonances turn the phase more than noise
LOW = 4  # one of so many lines tells the sign


def turning_delay(response: FrequencyResponse) -> float:
    """Return the delay [s] by which the phase of a mass would turn as that of ``response`` does.

    >>> w = 2.0 * np.pi * np.arange(1.0, 250.0)
    >>> late = np.exp(-3e-3j * w) / (100j * w + 200.0)
    >>> round(turning_delay(FrequencyResponse.of(w / (2.0 * np.pi), late)) * 1e3, 2)
    3.02
    """
    phase = np.unwrap(np.angle(1j * response.response))
    weight = 1.0 / np.hypot(response.std, WEIGHED)
    rows = np.column_stack([np.ones(phase.size), -response.w]) * weight[:, None]
    return float(np.linalg.lstsq(rows, phase * weight)[0][1])


def has_wrong_sign(response: FrequencyResponse) -> bool:
    """Whether the velocity goes against the force at the low lines, whatever the delay.

    There j w G lies between 1/m, a mass, and j w/F, a friction: within 45 degrees about 45.

    >>> f = np.arange(1.0, 50.0)
    >>> [has_wrong_sign(FrequencyResponse.of(f, sign / (100j * f + 200.0))) for sign in (1.0, -1.0)]
    [False, True]
    """
    low = slice(0, max(4, len(response) // LOW))
    turned = 1j * response.response * np.exp(1j * response.w * turning_delay(response))
    mean = np.sum((turned / np.abs(turned) / np.hypot(response.std, WEIGHED))[low])
    return bool(np.real(mean * np.exp(-0.25j * np.pi)) < -0.5 * np.abs(mean))
