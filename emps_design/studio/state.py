"""The state of the studio's controls as one object, which can be saved to a TOML file and loaded from it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from pydantic import ValidationError

from emps_design.axis import Axis
from emps_design.control.velocity.gains import STRUCTURES, own_filters, own_structure
from emps_design.errors import InputError, nearest_name
from emps_design.laws.library.cascade import Filter
from emps_design.quantities import read_frequency
from emps_design.studio.ranges import CHOICES, Choice, choices_of, first_specification, position_gain

MOST_FILTERS = 8
SPECIFICATIONS = ("crossover", "bandwidth")
LABELS = {structure.label: structure for structure in STRUCTURES}
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


@dataclass(frozen=True, kw_only=True)
class State:
    """The numbers and words of the controls of all tabs, and the pinned design.

    ``axis`` has the sampling and the current loop of the controls. Structure and ``filters`` of the velocity loop are
    those of its controller until the user changes them. :data:`~.ranges.CHOICES` has the labels and units of the
    numbers.

    >>> from emps_design.machines import machine
    >>> state = State.of(machine("emps2018"))
    >>> State.from_toml(state.to_toml()) == state
    True
    """

    axis: Axis
    pinned: State | None = None
    specification: str = "crossover"
    frequency: float
    phase_margin_deg: float
    structure: str = "IP"
    filters: tuple[Filter, ...] = ()
    required_phase_deg: float
    required_overshoot_percent: float
    period_ms: float
    computation_delay: int
    current_ms: float
    k_e1: float
    hand: float
    wall: float
    mass: float
    damping: float
    filter: float
    mismatch_percent: float
    place: str = "plant input"
    task: str = "guided"
    push: float
    hand_stiffness: float
    hand_damping: float
    motion: str = "there and back"
    stroke: float
    speed: float
    acceleration: float
    pause: float
    position_kp: float
    feedforward: str = "of the axis"
    plants: int
    seed: int
    friction: str = "symmetric"

    @classmethod
    def of(cls, axis: Axis) -> State:
        """Return the default values on ``axis``, with a specification that meets the requirements."""
        specification: dict[str, Any] = first_specification(axis)
        return replace(cls.defaults(axis), **specification)

    @classmethod
    def defaults(cls, axis: Axis) -> State:
        """Return the default of every control on ``axis``, whether or not the design meets the requirements."""
        first: dict[str, Any] = {name: choice.first for name, choice in choices_of(axis).items()}
        return cls(axis=axis, **{**first, **_clock(axis), **_law(axis)})

    def with_axis(self, axis: Axis) -> State:
        """Return the same specification on another ``axis``.

        Sampling and current loop are those of ``axis``, and so are structure, filters and position gain unless the user
        has changed them. A number that has another unit on ``axis`` gets its default value.

        >>> from emps_design.machines import machine
        >>> light = machine("emps2018").replace(mechanics={"mass": 1.2})
        >>> moved = State.of(machine("emps2018")).with_axis(light)
        >>> moved.mass, moved.damping, moved.frequency
        (50.0, 100.0, 100.0)
        """
        defaults, before, now = State.defaults(axis), _law(self.axis), _law(axis)
        unchanged = {name for name in now if getattr(self, name) == before[name]}
        if position_gain(axis) is None and position_gain(self.axis) is None:
            unchanged.discard("position_kp")  # neither axis has one
        other_units = {name for name, choice in CHOICES.items() if _unit(choice, axis) != _unit(choice, self.axis)}
        replaced: dict[str, Any] = {name: getattr(defaults, name) for name in (*_clock(axis), *unchanged, *other_units)}
        return replace(self, axis=axis, **replaced)

    @property
    def choices(self) -> dict[str, Choice]:
        """The ranges of the controls on the axis, extended to the numbers of the state."""
        return {name: choice.with_value(getattr(self, name)) for name, choice in choices_of(self.axis).items()}

    def changed(self, **values: Any) -> State:
        """Return the state with some numbers changed, each within the range of its control, and the axis updated."""
        return self._changed(values, self.choices)

    def _changed(self, values: dict[str, Any], choices: Mapping[str, Choice], source: str = "studio") -> State:
        state = replace(self, **{name: checked(name, value, choices, source) for name, value in values.items()})
        if not {"period_ms", "computation_delay", "current_ms"} & set(values):
            return state
        axis = state.axis.replace(
            sampling={"period": state.period_ms * 1e-3, "computation_delay": int(state.computation_delay)},
            drive={"current_time_constant": state.current_ms * 1e-3},
        )
        return replace(state, axis=axis)

    @property
    def requested(self) -> dict[str, Any]:
        """The arguments of the velocity-loop design."""
        law = {"structure": LABELS[self.structure], "filters": self.filters}
        return {self.specification: self.frequency, "phase_margin_deg": self.phase_margin_deg, **law}

    def to_toml(self) -> str:
        """Return the state as TOML: tables [studio] and [axis], and both in [pinned] if a design is pinned."""
        import tomli_w

        return tomli_w.dumps(self._tables())

    def _tables(self) -> dict[str, Any]:
        names = [field.name for field in fields(self) if field.name not in ("axis", "pinned")]
        values = {name: getattr(self, name) for name in names}
        values["filters"] = [filter.model_dump(exclude_none=True) for filter in self.filters]
        pinned = {} if self.pinned is None else {"pinned": self.pinned._tables()}
        return {"studio": values, "axis": self.axis.to_dict(), **pinned}

    @classmethod
    def from_toml(cls, text: str, source: str = "state") -> State:
        """Read a state from TOML; raises :class:`InputError` in one line with what was found and expected."""
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
        state = cls.of(Axis.from_dict(tables["axis"], f"{source}: axis"))
        entries = tables["studio"]
        choices = {name: choice.of_any_axis(entries.get(name)) for name, choice in choices_of(state.axis).items()}
        values = {name: checked(name, value, choices, source) for name, value in entries.items()}
        # Numbers equal to those of the axis leave the axis unchanged, to the last digit.
        other = {name: value for name, value in values.items() if getattr(state, name) != value}
        return state._changed(other, choices, source)


def checked(name: str, value: Any, choices: Mapping[str, Choice] = CHOICES, source: str = "studio") -> Any:
    """Return ``value`` checked and converted: a frequency to rad/s, tables of filters to filters.

    Raises :class:`InputError` for an unknown name, a word that is no option, or a number outside a control's range.

    >>> round(checked("frequency", "30Hz"), 3), checked("seed", 7), checked("place", "plant input")
    (188.496, 7, 'plant input')
    """
    if name in WORDS:
        if value not in WORDS[name]:
            raise InputError(f"{source}: {name}: found {value!r}, expected {' or '.join(WORDS[name])}")
        return value
    if name == "filters":
        return _filters(value, source)
    if name not in choices:
        raise InputError(f"{source}: unknown key {name!r}{nearest_name(name, [*choices, *WORDS, 'filters'])}")
    choice = choices[name]
    if choice.frequency and isinstance(value, str):
        try:
            value = read_frequency(value)
        except InputError as error:
            raise InputError(f"{source}: {name}: {error}") from error
    kind, what = (int, "a whole number, ") if isinstance(choice.step, int) else (int | float, "")
    if isinstance(value, bool) or not isinstance(value, kind) or not choice.holds(value):
        raise InputError(f"{source}: {name}: found {value!r}, expected {what}{choice.lower:g} to {choice.upper:g}")
    return value


def _filters(tables: Any, source: str) -> tuple[Filter, ...]:
    """Return filters from tables as in an axis file; a frequency is in Hz unless it has a unit."""
    if not isinstance(tables, list | tuple) or len(tables) > MOST_FILTERS:
        raise InputError(f"{source}: filters: found {tables!r}, expected up to {MOST_FILTERS} tables")
    filters = []
    for place, table in enumerate(tables):
        entries = dict(table) if isinstance(table, dict | Filter) else {}
        try:
            if isinstance(entries.get("frequency"), str):
                entries["frequency"] = read_frequency(entries["frequency"], "Hz")
            filters.append(Filter.model_validate(entries))
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            where = ".".join(("filters", str(place), *map(str, problem["loc"])))
            raise InputError(f"{source}: {where}: {problem['msg']}") from error
        except InputError as error:
            raise InputError(f"{source}: filters.{place}: {error}") from error
    return tuple(filters)


def conversion_in_words(name: str, value: Any) -> str:
    """Return a sentence with the rad/s of a frequency that was entered with a unit, "" for any other ``value``.

    >>> conversion_in_words("frequency", "30Hz"), conversion_in_words("frequency", "188.5")
    ('Frequency: 30Hz is 188.496 rad/s.', '')
    """
    if not isinstance(value, str) or name not in CHOICES or value.strip()[-1:] in "0123456789.":
        return ""
    return f"{CHOICES[name].label.partition(' [')[0]}: {value.strip()} is {read_frequency(value):.6g} rad/s."


def differences_in_words(before: State, after: State) -> str:
    """Return a sentence with the numbers that differ between ``before`` and ``after``, on another axis; "" if none.

    >>> from emps_design.machines import machine
    >>> before = State.of(machine("emps2018"))
    >>> fast = machine("emps2018").replace(name="fast", sampling={"period": 5e-4})
    >>> differences_in_words(before, before.with_axis(fast))
    'Changed with fast: sampling period 0.5 ms.'
    """
    changes, reset = [], ""
    for name, choice in CHOICES.items():
        label, _, unit = after.axis.units.label(choice.label).rpartition(" [")
        if _unit(choice, after.axis) != _unit(choice, before.axis):
            reset = "Numbers in other units were reset."
        elif getattr(before, name) != getattr(after, name):
            changes.append(f"{label[:1].lower()}{label[1:]} {getattr(after, name):g} {unit.rstrip(']')}")
    if before.structure != after.structure:
        changes.append(f"structure {after.structure}")
    if before.filters != after.filters:
        changes.append(f"{len(after.filters) or 'no'} filter{'s' * (len(after.filters) != 1)}")
    changed = f"Changed with {after.axis.name}: {', '.join(changes)}." if changes else ""
    return f"{changed} {reset}".strip()


def _unit(choice: Choice, axis: Axis) -> str:
    """The unit of a number on ``axis``."""
    return axis.units.label(choice.label).rpartition("[")[2]


def _law(axis: Axis) -> dict[str, Any]:
    """Return structure, filters and position gain of the controller of ``axis``, by default the first gain."""
    kp = position_gain(axis)
    first = choices_of(axis)["position_kp"].first
    return {
        "structure": own_structure(axis).label,
        "filters": own_filters(axis),
        "position_kp": first if kp is None else kp,
    }


def _clock(axis: Axis) -> dict[str, Any]:
    """Return sampling and current loop of ``axis`` as the controls show them."""
    return {
        "period_ms": round(axis.sampling.period * 1e3, 9),
        "computation_delay": axis.sampling.computation_delay,
        "current_ms": round(axis.drive.current_time_constant * 1e3, 9),
    }
