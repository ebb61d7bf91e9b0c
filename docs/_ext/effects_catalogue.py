"""Write the catalogue of effects from the effects themselves: a page each, with a simulated picture."""

import hashlib
import json
import math
from pathlib import Path

from emps_design.effects import EFFECTS
from emps_design.machines import machine
from emps_design.simulation import Plant, trapezoid_laps

MACHINE = "emps2019"


def typical(parameter) -> float:
    """A size at which the effect can be seen: its scale, or the middle of its starts."""
    value = parameter.scale or (parameter.starts[len(parameter.starts) // 2] if parameter.starts else 0.0)
    return min(max(value, parameter.lower), parameter.upper)


def page(effect) -> str:
    """The catalogue page of one effect as MyST."""
    rows = [
        f"| {p.name} | ${p.symbol}$ | {p.unit or '-'} | {bounds(p)} | "
        f"{p.text}{', belongs to a record' * p.per_record} |"
        for p in effect.parameters
    ]
    others = {other.name: other for other in EFFECTS}
    confused = (
        ", ".join(f"[{others[name].label}](#{anchor(name)})" for name in effect.search.confused_with) or "nothing here"
    )
    numbers = ", ".join(f"{p.name} {typical(p):g} {p.unit}".strip() for p in effect.parameters)
    return f"""({anchor(effect.name)})=
# {effect.label}

`{effect.name}` · {effect.channel} · {effect.source}

$$
{effect.equation}
$$

| parameter | symbol | unit | range | meaning |
|---|---|---|---|---|
{chr(10).join(rows)}

**Signature.** {sentence(effect.words.where)}

```{{image}} {effect.name}.png
:alt: Change of the motor force that {effect.label} makes, against time and against velocity
```

Change of the motor force of {MACHINE} over one synthetic lap, with and without the effect ({numbers}).

**Confused with.** {confused}.

**The experiment that tells them apart.** {sentence(effect.words.experiment)}

**What to do.** {sentence(effect.words.remedy)}
"""


def bounds(parameter) -> str:
    """The range of a parameter in words."""
    low = f"{parameter.lower:g}" if math.isfinite(parameter.lower) else ""
    high = f"{parameter.upper:g}" if math.isfinite(parameter.upper) else ""
    return f"{low or 'any'} to {high or 'any'}" if low or high else "any"


def sentence(text: str) -> str:
    """``text`` with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def anchor(name: str) -> str:
    """The link target of an effect's page."""
    return f"effect-{name.replace('_', '-')}"


def draw(effect, path: Path) -> None:
    """Draw what the effect changes in the motor force of a synthetic lap."""
    import numpy as np
    from matplotlib.figure import Figure

    axis = machine(MACHINE)
    q_ref = trapezoid_laps(axis.sampling.period, laps=1)
    parameters = {parameter.name: typical(parameter) for parameter in effect.parameters}
    without = Plant.of(axis).closed_loop(q_ref)
    extended = axis.replace(motion=effect.motion or axis.motion, effects=[{"kind": effect.name, **parameters}])
    run = Plant.of(extended).closed_loop(q_ref)
    change = run.force - without.force
    figure = Figure(figsize=(8, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    left.plot(run.t, change, lw=0.7, color="#0072B2")
    left.set(xlabel="time [s]", ylabel="change of force [N]")
    right.plot(without.v, change, ".", ms=1, color="#D55E00")
    right.set(xlabel="velocity [m/s]")
    low, high = np.quantile(change, [0.001, 0.999])
    reach = max(high - low, 0.1)
    left.set_ylim(low - 0.2 * reach, high + 0.2 * reach)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def write(app) -> None:
    """Write the catalogue; a page whose effect did not change is left alone."""
    folder = Path(app.srcdir) / "catalogue"
    folder.mkdir(exist_ok=True)
    for effect in EFFECTS:
        text = page(effect)
        mark = hashlib.sha256(text.encode()).hexdigest()
        note = folder / f".{effect.name}.json"
        if note.exists() and json.loads(note.read_text()) == mark and (folder / f"{effect.name}.png").exists():
            continue
        draw(effect, folder / f"{effect.name}.png")
        (folder / f"{effect.name}.md").write_text(text, encoding="utf-8")
        note.write_text(json.dumps(mark))
    toc = "\n".join(effect.name for effect in EFFECTS)
    index = (
        "# Effects\n\nEverything the program can look for beyond mass, viscous, Coulomb and constant force; "
        f"{len(EFFECTS)} effects, in the order in which they are tried. These pages are written from the effects "
        f"themselves.\n\n```{{toctree}}\n:maxdepth: 1\n\n{toc}\n```\n"
    )
    (folder / "index.md").write_text(index, encoding="utf-8")


def setup(app):
    """Write the catalogue before Sphinx looks for pages."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
