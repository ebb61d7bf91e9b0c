"""A request: all options of a command or of a function as the fields of one frozen dataclass.

A field says once what its option is: default, help, unit, bounds, choices, how a text is read. The command line, the
studio, ``help()`` and the function itself are made from it, so an option has one name and one meaning everywhere.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, ParamSpec, TypeVar, get_type_hints

from emps_design.errors import InputError, nearest_name
from emps_design.progress import Progress, no_progress
from emps_design.quantities import read_frequency, read_ratio
from emps_design.units import LINEAR, Units

OPTION = "option"  # the key of an Option in the metadata of a field

# What a parameter of a type takes, in words; a text or None in its place is refused, other types are not looked at.
KINDS = {
    "Axis": "an Axis, such as load_axis(path)",
    "Record": "a Record, such as read_record(path)",
    "VelocityLoopDesign": "a VelocityLoopDesign",
    "float": "a number",
    "int": "a whole number",
    "bool": "True or False",
    "None": "None",
}

# Declarations of an option that is a frequency or a ratio: option(None, "... [rad/s, or such as 30Hz]", **RAD_S).
RAD_S: dict[str, Any] = {
    "parse": functools.partial(read_frequency, unit="rad/s"),
    "metavar": "FREQUENCY",
    "typed": str | None,
}
HERTZ: dict[str, Any] = {**RAD_S, "parse": functools.partial(read_frequency, unit="Hz")}
RATIO: dict[str, Any] = {"parse": read_ratio, "metavar": "RATIO", "typed": str | None}


@dataclass(frozen=True)
class Option:
    """What a field of a request is beside its name, type and default.

    ``unit`` is that of a linear axis with a voltage command ("" for a ratio): the number is checked against its
    plausible range. ``limits`` are the least and the largest number, ``choices`` the words allowed. ``flags`` replace
    the flag made of the name. ``parse`` reads the text of the command line; ``read`` makes the value from a name or a
    path and the axis of the request. ``writes`` is the kind of file written to the path, the kinds by suffix, such as
    ``.csv``, or those by the name of each file written to a folder. An option that is ``printed`` changes what is
    printed, not the document. A ``hidden`` one is for Python alone.
    """

    help: str = ""
    unit: str | None = None
    limits: tuple[float | None, float | None] = (None, None)
    choices: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    argument: bool = False
    metavar: str | None = None
    parse: Callable[[str], Any] | None = None
    read: Callable[[Any, Any], Any] | None = None
    typed: Any = None  # type on the command line, where it is not that of the field
    writes: str | Mapping[str, str] = ""
    printed: bool = False
    hidden: bool = False


def option(default: Any, help: str, **declaration: Any) -> Any:
    """A field of a request; ``declaration`` are the other fields of :class:`Option`, ``default`` ``...`` for none."""
    return field(default=MISSING if default is ... else default, metadata={OPTION: Option(help, **declaration)})


@dataclass(frozen=True)
class Request:
    """Base of every request.

    ``given`` are the names of the fields that the user set, ``sources`` the names and paths that values were read from;
    ``progress`` gets the stage and the share done; with ``overwrite`` files that hold something else may be replaced.
    Other fields that are no options are for Python alone.

    >>> @dataclass(frozen=True)
    ... class Push(Request):
    ...     force: float = option(1.0, "force on the carriage [N]", unit="N")
    ...     chart: str = option("line", "what is drawn", choices=("line", "bars"))
    >>> Push(force=2.0).force
    2.0
    >>> Push(chart="bar")
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: `chart`: found 'bar', expected one of line, bars, did you mean 'bars'?
    """

    given: frozenset[str] = field(default=frozenset(), kw_only=True, repr=False, compare=False)
    sources: Mapping[str, Any] = field(default_factory=dict, kw_only=True, repr=False, compare=False)
    progress: Progress = field(default=no_progress, kw_only=True, repr=False, compare=False)
    overwrite: bool = field(default=False, kw_only=True, repr=False, compare=False)
    overwrites: ClassVar[bool] = False  # whether it checks ``overwrite`` itself, beside options that are written

    def __post_init__(self) -> None:
        axis = getattr(self, "axis", None)
        if isinstance(axis, str | Path):  # of a request made without make_request
            about: Option = type(self).__dataclass_fields__["axis"].metadata[OPTION]
            object.__setattr__(self, "axis", axis if about.read is None else about.read(axis, None))
        for declared in _declared_by(type(self)).checked:
            _check(declared, getattr(self, declared.name), self.units)

    @property
    def units(self) -> Units:
        """The units of its axis, or of a linear one."""
        return getattr(getattr(self, "axis", None), "units", LINEAR)

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Raise :class:`InputError` with ``why`` if one of ``names``, which would have no effect, is set.

        An option is set where the user gave it, even with its default, or where it has another value.
        """
        declared = {entry.name: entry for entry in options_of(type(self))}
        unused = [name for name in names if name in self.given or self._changed(declared[name])]
        if unused:
            raise InputError(f"{', '.join(f'`{name}`' for name in unused)}: {why}")

    def _changed(self, entry: Field[Any]) -> bool:
        """Whether the value of an option differs from its default; one that is read from a name does not tell."""
        return entry.metadata[OPTION].read is None and getattr(self, entry.name) != entry.default


def _check(declared: Field[Any], value: Any, units: Units) -> None:
    """Check ``value`` of a field against unit, limits and choices."""
    about, name = declared.metadata[OPTION], f"`{declared.name}`"
    if value is None:
        return
    if about.choices and value not in about.choices:
        expected = ", ".join(choice for choice in about.choices if choice)
        raise InputError(
            f"{name}: found {value!r}, expected one of {expected}{nearest_name(str(value), about.choices)}"
        )
    least, most = about.limits
    if (least is not None and value < least) or (most is not None and value > most):
        span = f"at least {least}" if most is None else f"at most {most}" if least is None else f"{least} to {most}"
        raise InputError(f"{name}: found {value!r}, expected {span}")
    if about.unit is not None:
        units.check(name, value, about.unit, positive=True)


@dataclass(frozen=True)
class _Declared:
    """The options of a request, arguments first: all, those checked, and those read, the axis first."""

    options: tuple[Field[Any], ...]
    checked: tuple[Field[Any], ...]
    read: tuple[Field[Any], ...]


_declared: dict[type[Request], _Declared] = {}  # once for each request, as a simulation is called very often


def _declared_by(request: type[Request]) -> _Declared:
    """What ``request`` declares."""
    if request not in _declared:
        fields = [entry for entry in dataclasses.fields(request) if OPTION in entry.metadata]
        options = sorted(fields, key=lambda entry: not entry.metadata[OPTION].argument)
        about = {entry.name: entry.metadata[OPTION] for entry in options}
        read = sorted((e for e in options if _is_read(about[e.name])), key=lambda entry: entry.name != "axis")
        checked = [entry for entry in options if _is_checked(about[entry.name])]
        _declared[request] = _Declared(tuple(options), tuple(checked), tuple(read))
    return _declared[request]


def _is_checked(about: Option) -> bool:
    return about.unit is not None or bool(about.choices) or about.limits != (None, None)


def _is_read(about: Option) -> bool:
    return about.read is not None or about.parse is not None


def options_of(request: type[Request]) -> tuple[Field[Any], ...]:
    """The fields of ``request`` that are options, arguments first."""
    return _declared_by(request).options


def flags_of(declared: Field[Any]) -> tuple[str, ...]:
    """The flags of an option on the command line, the one that messages name first; an argument has its name there."""
    if declared.metadata[OPTION].argument:
        return (declared.name.upper(),)
    return declared.metadata[OPTION].flags or (f"--{declared.name.strip('_').replace('_', '-')}",)


RequestType = TypeVar("RequestType", bound=Request)


def make_request(
    kind: type[RequestType],
    values: Mapping[str, Any],
    given: Iterable[str],
    on_units: Callable[[Units], None] = lambda units: None,
    **more: Any,
) -> RequestType:
    """A request of ``kind`` from ``values``: texts, names and paths are read, the axis first, for it tells how to.

    ``given`` are the names that the user set; ``more`` are fields that are no options. ``on_units`` is called with
    the units of the axis. The options are checked before records are read.
    """
    made, sources, late = dict(values), {}, []
    for entry in _declared_by(kind).read:
        name, reader = entry.name, entry.metadata[OPTION].read
        value = values.get(name, entry.default)
        if reader is not None and name in values:
            sources[name] = value
        if value is MISSING:
            continue
        made[name] = value
        if reader is not None and name != "axis":
            late.append(entry)
            continue
        made[name] = _read(entry, value, made.get("axis"))
        if name == "axis":
            on_units(getattr(made[name], "units", LINEAR))
    request = kind(**made, given=frozenset(given), sources=sources, **more)
    records = {entry.name: _read(entry, made[entry.name], made.get("axis")) for entry in late}
    changed = {name: value for name, value in records.items() if value is not made[name]}
    return dataclasses.replace(request, **changed) if changed else request


def _read(entry: Field[Any], value: Any, axis: Any) -> Any:
    """``value`` of a field, with a text or a path in it made what it stands for."""
    about: Option = entry.metadata[OPTION]
    if isinstance(value, list | tuple) and (about.read or about.parse):
        return tuple(_read(entry, member, axis) for member in value)
    if isinstance(value, str | Path) and about.read is not None:
        return about.read(value, axis)
    if isinstance(value, str) and about.parse is not None:
        try:
            return about.parse(value)
        except InputError as error:
            raise InputError(f"`{entry.name}`: {error}") from error
    return value


Answer = TypeVar("Answer")
Parameters = ParamSpec("Parameters")


def typed(function: Callable[Parameters, Answer]) -> Callable[Parameters, Answer]:
    """Let ``function`` refuse texts and None in the place of numbers, axes and records, in one line.

    >>> @typed
    ... def half(length: float) -> float:
    ...     return length / 2
    >>> half("3 mm")
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: `length`: found '3 mm', expected a number
    """
    signature = inspect.signature(function)
    plain = _plain(signature)

    @functools.wraps(function)
    def call(*arguments: Parameters.args, **named: Parameters.kwargs) -> Answer:
        _refuse_other_kinds(plain, signature.bind(*arguments, **named).arguments)
        return function(*arguments, **named)

    return call


def _plain(signature: inspect.Signature) -> dict[str, list[str]]:
    """The parameters that take nothing but what ``KINDS`` names, and what each takes."""
    kinds = {name: str(each.annotation).split(" | ") for name, each in signature.parameters.items()}
    return {name: own for name, own in kinds.items() if set(own) <= KINDS.keys()}


def _refuse_other_kinds(plain: Mapping[str, list[str]], values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        kinds = plain.get(name)
        if kinds and (isinstance(value, str | Path) or (value is None and "None" not in kinds)):
            raise InputError(f"`{name}`: found {value!r}, expected {' or '.join(KINDS[kind] for kind in kinds)}")


def takes(kind: type[Request]) -> Callable[[Callable[..., Answer]], Callable[..., Answer]]:
    """Let a function whose last parameter is a request be called with the fields of the request.

    ``help()`` shows every option with its unit and meaning. A request itself is taken as it is. Further keywords may
    follow the request.

    >>> @dataclass(frozen=True)
    ... class Push(Request):
    ...     force: float = option(1.0, "force on the carriage [N]", unit="N")
    >>> @takes(Push)
    ... def push(request: Push) -> float:
    ...     '''The force, doubled.'''
    ...     return 2.0 * request.force
    >>> push(3.0), push(force=4.0), push(Push(5.0))
    (6.0, 8.0, 10.0)
    >>> list(inspect.signature(push).parameters)
    ['force', 'progress']
    """

    def decorate(function: Callable[..., Answer]) -> Callable[..., Answer]:
        before, after = _around_request(function)
        signature = _signature(kind, function)
        others = [entry.name for entry in _for_python(kind)]
        read = {entry.name for entry in _declared_by(kind).read}
        plain = {name: kinds for name, kinds in _plain(signature).items() if name not in read}

        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Answer:
            if len(arguments) == len(before) + 1 and isinstance(arguments[-1], kind):
                return function(*arguments, **named)
            values = signature.bind(*arguments, **named).arguments
            _refuse_other_kinds(plain, values)
            passed = [values.pop(parameter.name, parameter.default) for parameter in before]
            own = {name: value for name in others if (value := values.pop(name, None)) is not None}
            more = {name: value for parameter in after for name, value in values.pop(parameter.name, {}).items()}
            return function(*passed, make_request(kind, values, values, **own), **more)

        described: Any = call
        described.__signature__ = signature
        lines = [f"    {entry.name}: {entry.metadata[OPTION].help}" for entry in options_of(kind)]
        described.__doc__ = "\n".join([inspect.cleandoc(function.__doc__ or ""), "", "Options:", *lines])
        return call

    return decorate


def _around_request(function: Callable[..., Any]) -> tuple[list[inspect.Parameter], list[inspect.Parameter]]:
    """The parameters of ``function`` before its request, such as self, and after it: further keywords, if any."""
    own = list(inspect.signature(function).parameters.values())
    last = len(own) - (own[-1].kind is inspect.Parameter.VAR_KEYWORD)
    return own[: last - 1], own[last:]


def _signature(kind: type[Request], function: Callable[..., Any]) -> inspect.Signature:
    """The signature of ``function`` with the fields of ``kind`` in the place of its request."""
    before, after = _around_request(function)
    options = [
        inspect.Parameter(
            entry.name,
            inspect.Parameter.POSITIONAL_OR_KEYWORD,
            default=inspect.Parameter.empty if entry.default is MISSING else entry.default,
            annotation=entry.type,
        )
        for entry in options_of(kind)
    ]
    others = [
        inspect.Parameter(entry.name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=entry.type)
        for entry in _for_python(kind)
    ]
    returned = inspect.signature(function).return_annotation
    return inspect.Signature([*before, *options, *others, *after], return_annotation=returned)


def _for_python(kind: type[Request]) -> list[Field[Any]]:
    """The fields of ``kind`` that are no options, and that a caller in Python may set."""
    own = ("given", "sources", "overwrite")
    return [entry for entry in dataclasses.fields(kind) if OPTION not in entry.metadata and entry.name not in own]


def types_of(kind: type[Request]) -> dict[str, Any]:
    """The type of each option on the command line."""
    typed = {entry.name: entry.metadata[OPTION].typed for entry in options_of(kind)}
    hints = get_type_hints(kind) if None in typed.values() else {}
    return {name: hints[name] if own is None else own for name, own in typed.items()}
