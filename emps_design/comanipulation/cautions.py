"""What to read with the numbers of an impedance law: each warning where the finding is, in one place."""

from __future__ import annotations

import math
from typing import Any

from emps_design.control.impedance.equivalence import safety_words
from emps_design.control.impedance.law import PRINTED
from emps_design.control.impedance.robustness import sinking_force
from emps_design.laws.friction_model import left_out


def cautions_of(found: Any, document: dict[str, Any]) -> list[str]:
    """Warnings on the :class:`ImpedanceAssessment` ``found``, whose other results are in ``document``."""
    axis, law = found.axis, found.law
    words = [] if found.stable else [found.reason]
    if law.at_singularity(PRINTED):
        words.append(
            "printed is undefined: at M_a = 2 M the current cancels itself in (30) as printed; derived it is not"
        )
    sinking = sinking_force(found.plant)
    if sinking > 0.0:
        words.append(
            f"the constant force exceeds dry friction by {sinking:.3g} N, and at rest this law holds nothing: the "
            "axis sinks; balance that force apart"
        )
    words += [
        f"effect {kind} is in the simulated plants and, linearised, in the poles, but not in apparent impedance "
        "and contact"
        for kind in left_out(axis)
    ]
    words += safety_words(axis, law.mass, law.damping, found.mismatch or 0.0)
    if document["smallest_safe_mass"] is None:
        words.append(
            "smallest_safe_mass is undefined: with this filter and damping the law is unstable or swings even at "
            "M_a = M"
        )
    if law.damping == 0.0:
        words.append("damping B is 0: nothing brings the released carriage to rest")
    oscillation = document["coulomb_oscillation"]
    if oscillation is not None and oscillation["speed"] > 2.0 * found.slowest_drift:
        words.append(
            f"the Coulomb compensation may hunt, at {1e3 * oscillation['speed']:.2g} mm/s or more and below "
            f"{oscillation['frequency']:.2g} rad/s (describing function); a smaller Coulomb factor removes it, or "
            "a faster filter where the loop bears one"
        )
    contact = document["passivity"]
    if contact is None:
        words.append("passivity and largest_wall_stiffness are undefined: the loop is unstable without contact")
    elif any(high is None for _, high in contact["continuous"]["active_bands"]):
        words.append("passivity.continuous: the active band is unbounded above")
    if contact is not None and not contact["sampled"]["passive"]:
        low = contact["sampled"]["active_bands"][0][0]
        wall = document["largest_wall_stiffness"]
        words.append(
            f"not passive from {low:.3g} rad/s on"
            + ("" if wall is None else f"; the poles bear an undamped wall of up to {wall:.3g} N/m")
        )
    for name, limit in found.walls.items():
        which = "exact estimates" if name == "exact" else f"estimates off by +-{100 * (found.mismatch or 0.0):g} %"
        words.append(
            f"{which}: pressed against a wall the carriage comes to rest up to {limit.simulated:.3g} N/m; beyond, "
            "the Coulomb compensation may keep it swinging (simulated with pushes around "
            f"{limit.push:.3g} N; the poles alone bear {limit.linear:.3g} N/m)"
        )
    if contact is not None and document["largest_wall_stiffness"] is None:
        words.append("largest_wall_stiffness is unbounded: stable up to 1 GN/m")
    mismatch = document.get("mismatch")
    if mismatch is not None and found.study is not None:
        words += found.study.warnings
        if math.isinf(mismatch["creep_speed"]):
            words.append("mismatch.creep_speed is unbounded: at a corner the apparent damping is not positive")
        elif mismatch["creep_speed"] > 0.0:
            factor = mismatch["coulomb_factor_without_creep"]
            cure = "no Coulomb factor" if factor is None else f"a Coulomb factor of {factor:.4g}"
            words.append(
                f"over-estimated friction makes the released carriage creep at up to "
                f"{1e3 * mismatch['creep_speed']:.3g} mm/s; {cure} rules it out"
            )
        if mismatch["worst"]["peak_voltage"] >= axis.drive.command_limit:
            words.append("the voltage limit is reached in the task")
    return words
