"""What the studio's controls hold, as one object that is saved to and loaded from a TOML file."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields, replace
from typing import Any

from pydantic import ValidationError

from emps_design.axis import Axis
from emps_design.control.velocity.structure import STRUCTURES, own_filters, own_structure
from emps_design.errors import InputError, nearest_name
from emps_design.laws.library.cascade import Filter
from emps_design.quantities import read_frequency


@dataclass(frozen=True)
class Choice:
    """A number that a control sets: its label with the unit, its range and the step of the control.

    A ``frequency`` is in rad/s, and may be given as text with its unit, such as 30Hz.
    """

    label: str
    lower: float
    upper: float
    step: float
    frequency: bool = False


CHOICES: dict[str, Choice] = {
    "frequency": Choice("Frequency [rad/s]", 5.0, 600.0, 1.0, frequency=True),
    "phase_margin_deg": Choice("Phase margin [deg]", 1.0, 89.0, 0.5),
    "period_ms": Choice("Sampling period [ms]", 0.1, 5.0, 0.1),
    "computation_delay": Choice("Computation delay [samples]", 0, 5, 1),
    "current_ms": Choice("Current loop [ms]", 0.0, 5.0, 0.05),
    "k_e1": Choice("Force gain k_e1 [(m/s)/N]", 0.0005, 0.1, 0.0005),
    "hand": Choice("Viscous hand [N/(m/s)]", 0.0, 500.0, 5.0),
    "wall": Choice("Wall [N/mm]", 0.0, 200.0, 1.0),
    "mass": Choice("Apparent mass M_a [kg]", 1.0, 200.0, 1.0),
    "damping": Choice("Apparent damping B [N/(m/s)]", 0.0, 500.0, 5.0),
    "filter": Choice("Filter of the law [rad/s]", 10.0, 3000.0, 10.0, frequency=True),
    "mismatch_percent": Choice("Mismatch [%]", 0.0, 20.0, 0.5),
    "required_phase_deg": Choice("Required phase margin, sampled [deg]", 0.0, 80.0, 1.0),
    "required_overshoot_percent": Choice("Allowed overshoot [%]", 0.0, 100.0, 1.0),
    "push": Choice("Push [N]", 1.0, 500.0, 5.0),
    "hand_stiffness": Choice("Hand stiffness [N/m]", 0.0, 20000.0, 100.0),
    "hand_damping": Choice("Hand damping [N/(m/s)]", 0.0, 2000.0, 10.0),
    "stroke": Choice("Stroke [m]", 1e-6, 1000.0, 0.01),
    "speed": Choice("Speed [m/s]", 1e-6, 1000.0, 0.01),
    "acceleration": Choice("Acceleration [m/s^2]", 1e-6, 1e6, 0.1),
    "pause": Choice("Pause [s]", 0.0, 100.0, 0.1),
    "position_kp": Choice("Position gain kp [1/s]", 0.01, 10000.0, 1.0),
    "plants": Choice("Random plants", 0, 10000, 100),
    "seed": Choice("Seed", 0, 10**6, 1),
}
MOST_FILTERS = 8
SPECIFICATIONS = ("crossover", "bandwidth")
LABELS = {one.label: one for one in STRUCTURES}
PLACES = ("plant input", "velocity error")
MOTIONS = ("there and back", "file", "record")
FEEDFORWARDS = ("of the axis", "none", "velocity", "velocity and acceleration")
TASKS = ("guided", "pushed")
FRICTIONS = ("symmetric", "asymmetric")
WORDS = {
    "specification": SPECIFICATIONS,
    "structure": tuple(LABELS),
    "place": PLACES,
    "task": TASKS,
    "friction": FRICTIONS,
    "motion": MOTIONS,
    "feedforward": FEEDFORWARDS,
}


@dataclass(frozen=True)
class State:
    """Everything the controls of all tabs hold, and the design that is pinned.

    ``axis`` has the sampling and the current loop of the controls; structure and ``filters`` of the velocity loop are
    those of its controller until others are chosen.

    >>> from emps_design.machines import machine
    >>> state = State.of(machine("emps2018"))
    >>> State.from_toml(state.to_toml()) == state
    True
    """

    axis: Axis
    pinned: State | None = None
    specification: str = "crossover"
    frequency: float = 100.0
    phase_margin_deg: float = 60.0
    structure: str = "IP"
    filters: tuple[Filter, ...] = ()
    required_phase_deg: float = 30.0
    required_overshoot_percent: float = 20.0
    period_ms: float = 1.0
    computation_delay: int = 0
    current_ms: float = 0.0
    k_e1: float = 0.01
    hand: float = 0.0
    wall: float = 10.0
    mass: float = 50.0
    damping: float = 100.0
    filter: float = 500.0
    mismatch_percent: float = 2.0
    place: str = "plant input"
    task: str = "guided"
    push: float = 40.0
    hand_stiffness: float = 1000.0
    hand_damping: float = 100.0
    motion: str = "there and back"
    stroke: float = 0.24
    speed: float = 0.2
    acceleration: float = 1.0
    pause: float = 0.1
    position_kp: float = 20.0
    feedforward: str = "of the axis"
    plants: int = 200
    seed: int = 0
    friction: str = "symmetric"

    @classmethod
    def of(cls, axis: Axis) -> State:
        """The controls as they stand for ``axis``."""
        return cls(axis).with_axis(axis)

    def with_axis(self, axis: Axis) -> State:
        """The same specification on another ``axis``."""
        structure, filters = own_structure(axis).label, own_filters(axis)
        kp = (axis.controller.position or {}).get("kp", self.position_kp)
        return replace(self, axis=axis, structure=structure, filters=filters, position_kp=kp, **_clock(axis))

    def changed(self, **values: Any) -> State:
        """The state with some numbers changed, each within the range of its control, and the axis kept in step."""
        state = replace(self, **{name: checked(name, value) for name, value in values.items()})
        if not {"period_ms", "computation_delay", "current_ms"} & set(values):
            return state
        axis = state.axis.replace(
            sampling={"period": state.period_ms * 1e-3, "computation_delay": int(state.computation_delay)},
            drive={"current_time_constant": state.current_ms * 1e-3},
        )
        return replace(state, axis=axis)

    @property
    def requested(self) -> dict[str, Any]:
        """Arguments of the velocity-loop design."""
        law = {"structure": LABELS[self.structure], "filters": self.filters}
        return {self.specification: self.frequency, "phase_margin_deg": self.phase_margin_deg, **law}

    def to_toml(self) -> str:
        """The state as a TOML document: tables [studio] and [axis], and both in [pinned] where a design is pinned."""
        import tomli_w

        return tomli_w.dumps(self._tables())

    def _tables(self) -> dict[str, Any]:
        values = {one.name: getattr(self, one.name) for one in fields(self) if one.name not in ("axis", "pinned")}
        values["filters"] = [one.model_dump(exclude_none=True) for one in self.filters]
        pinned = {} if self.pinned is None else {"pinned": self.pinned._tables()}
        return {"studio": values, "axis": self.axis.to_dict(), **pinned}

    @classmethod
    def from_toml(cls, text: str, source: str = "state") -> State:
        """Read a state; :class:`InputError` in one line names what was found and expected."""
        try:
            document = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{source}: not TOML, {error}") from error
        state = cls._of_tables(document, source)
        if "pinned" not in document:
            return state
        return replace(state, pinned=cls._of_tables(document["pinned"], f"{source}: pinned"))

    @classmethod
    def _of_tables(cls, document: Any, source: str) -> State:
        tables = document if isinstance(document, dict) else {}
        if not isinstance(tables.get("studio"), dict) or not isinstance(tables.get("axis"), dict):
            raise InputError(f"{source}: expected the tables [studio] and [axis] of a state saved by the studio")
        values = {name: checked(name, value, source) for name, value in tables["studio"].items()}
        state = cls.of(Axis.from_dict(tables["axis"], f"{source}: axis"))
        # A clock that says the same as the axis leaves the axis as it is, to the last digit.
        return state.changed(**{name: value for name, value in values.items() if getattr(state, name) != value})


def checked(name: str, value: Any, source: str = "studio") -> Any:
    """Return ``value`` as the state holds it, a frequency in rad/s.

    Raises :class:`InputError` for a name the controls do not have, a word they do not offer, or a number outside a
    control's range.

    >>> round(checked("frequency", "30Hz"), 3), checked("seed", 7), checked("place", "plant input")
    (188.496, 7, 'plant input')
    """
    if name in WORDS:
        if value not in WORDS[name]:
            raise InputError(f"{source}: {name}: found {value!r}, expected {' or '.join(WORDS[name])}")
        return value
    if name == "filters":
        return _filters(value, source)
    if name not in CHOICES:
        raise InputError(f"{source}: unknown key {name!r}{nearest_name(name, [*CHOICES, *WORDS, 'filters'])}")
    choice = CHOICES[name]
    if choice.frequency and isinstance(value, str):
        try:
            value = read_frequency(value)
        except InputError as error:
            raise InputError(f"{source}: {name}: {error}") from error
    kind, what = (int, "a whole number, ") if isinstance(choice.step, int) else (int | float, "")
    if isinstance(value, bool) or not isinstance(value, kind) or not choice.lower <= value <= choice.upper:
        raise InputError(f"{source}: {name}: found {value!r}, expected {what}{choice.lower:g} to {choice.upper:g}")
    return value


def _filters(tables: Any, source: str) -> tuple[Filter, ...]:
    """Filters from tables like those of an axis file; a frequency may have its unit, Hz where it has none."""
    if not isinstance(tables, list | tuple) or len(tables) > MOST_FILTERS:
        raise InputError(f"{source}: filters: found {tables!r}, expected up to {MOST_FILTERS} tables")
    found = []
    for place, table in enumerate(tables):
        given = dict(table) if isinstance(table, dict | Filter) else {}
        try:
            if isinstance(given.get("frequency"), str):
                given["frequency"] = read_frequency(given["frequency"], "Hz")
            found.append(Filter.model_validate(given))
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            where = ".".join(("filters", str(place), *map(str, problem["loc"])))
            raise InputError(f"{source}: {where}: {problem['msg']}") from error
        except InputError as error:
            raise InputError(f"{source}: filters.{place}: {error}") from error
    return tuple(found)


def taken_for(name: str, value: Any) -> str:
    """The sentence that says what a frequency typed with its unit was taken for; empty for any other ``value``.

    >>> taken_for("frequency", "30Hz"), taken_for("frequency", "188.5"), taken_for("mass", 50.0)
    ('Frequency: 30Hz is 188.496 rad/s.', '', '')
    """
    if not isinstance(value, str) or name not in CHOICES or value.strip()[-1:] in "0123456789.":
        return ""
    return f"{CHOICES[name].label.partition(' [')[0]}: {value.strip()} is {checked(name, value):.6g} rad/s."


def _clock(axis: Axis) -> dict[str, Any]:
    """Sampling and current loop of ``axis`` as the controls show them."""
    return {
        "period_ms": round(axis.sampling.period * 1e3, 9),
        "computation_delay": axis.sampling.computation_delay,
        "current_ms": round(axis.drive.current_time_constant * 1e3, 9),
    }
