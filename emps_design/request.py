"""A request: all options of a command or of a function as the fields of one frozen dataclass.

A field declares its option once: default, help, unit, bounds, choices, and how text is read. The command line, the
studio, ``help()`` and the signature of the function follow from it, so an option has the same name and meaning
everywhere.
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

# The expected value for each type, in words. Text or None is refused for these; other types are not checked.
KINDS = {
    "Axis": "an Axis, such as load_axis(path)",
    "Record": "a Record, such as read_record(path)",
    "VelocityLoopDesign": "a VelocityLoopDesign",
    "float": "a number",
    "int": "a whole number",
    "bool": "True or False",
    "None": "None",
}

# Declarations for a frequency or a ratio: option(None, "... [rad/s, or e.g. 30Hz]", **RAD_S).
RAD_S: dict[str, Any] = {
    "parse": functools.partial(read_frequency, unit="rad/s"),
    "metavar": "FREQUENCY",
    "typed": str | None,
}
HERTZ: dict[str, Any] = {**RAD_S, "parse": functools.partial(read_frequency, unit="Hz")}
RATIO: dict[str, Any] = {"parse": read_ratio, "metavar": "RATIO", "typed": str | None}


@dataclass(frozen=True)
class Option:
    """The declaration of an option: everything but the name, type and default of its field.

    - ``unit``: on a linear axis with a voltage command, "" for a ratio. The number must lie in its plausible range.
    - ``limits``: smallest and largest value; ``choices``: the allowed words.
    - ``flags``: instead of the flag that follows from the name.
    - ``parse``: function of the text on the command line; ``read``: function of a name or path and the request's axis.
    - ``writes``: the kind of the output file, a mapping from suffix, such as ``.csv``, to kind, or a mapping from the
      names of the files in an output folder to their kinds.
    - ``printed``: the option changes the printed text, not the document; ``hidden``: it is not on the command line.
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
    """A field of a request with the ``declaration`` of an :class:`Option`; ``default`` is ``...`` if it is required."""
    return field(default=MISSING if default is ... else default, metadata={OPTION: Option(help, **declaration)})


@dataclass(frozen=True)
class Request:
    """Base of every request.

    ``given`` holds the names of the fields that the user set, ``sources`` the names and paths of the values that were
    read. ``progress`` is called with the stage and the completed share. ``overwrite`` allows replacing files of another
    kind. Fields that are no options can be set from Python only.

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
    overwrites: ClassVar[bool] = False  # whether the command has --force although no option declares ``writes``

    def __post_init__(self) -> None:
        axis = getattr(self, "axis", None)
        if isinstance(axis, str | Path):  # the request was not made by make_request
            about: Option = type(self).__dataclass_fields__["axis"].metadata[OPTION]
            object.__setattr__(self, "axis", axis if about.read is None else about.read(axis, None))
        for declared in _declared_by(type(self)).checked:
            _check(declared, getattr(self, declared.name), self.units)

    @property
    def units(self) -> Units:
        """The units of the axis, or of a linear axis if the request has none."""
        return getattr(getattr(self, "axis", None), "units", LINEAR)

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Raise :class:`InputError` with ``why`` if one of the options ``names`` is set; it would have no effect.

        An option is set if the user gave it, even with its default value, or if it differs from its default.
        """
        declared = {entry.name: entry for entry in options_of(type(self))}
        unused = [name for name in names if name in self.given or self._changed(declared[name])]
        if unused:
            raise InputError(f"{', '.join(f'`{name}`' for name in unused)}: {why}")

    def _changed(self, entry: Field[Any]) -> bool:
        """Whether an option differs from its default; False for one that is read from a name or a path."""
        return entry.metadata[OPTION].read is None and getattr(self, entry.name) != entry.default


def _check(declared: Field[Any], value: Any, units: Units) -> None:
    """Raise :class:`InputError` if ``value`` violates the choices, limits or plausible range of its option."""
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
    """The options of a request: all (arguments first), those to check, and those to read (the axis first)."""

    options: tuple[Field[Any], ...]
    checked: tuple[Field[Any], ...]
    read: tuple[Field[Any], ...]


_declared: dict[type[Request], _Declared] = {}  # cached, as a simulation is called very often


def _declared_by(request: type[Request]) -> _Declared:
    """The options of ``request``, from the cache."""
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
    """The command-line flags of an option, first the one used in messages; for an argument its name in capitals."""
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
    """A request of ``kind`` from ``values``, whose texts, names and paths are read.

    The axis is read first, since records are read on it; then options are checked, then records are read. ``given``
    are the names that the user set; ``more`` are fields that are no options. ``on_units`` is called with the units of
    the axis.
    """
    fields, sources, deferred = dict(values), {}, []
    for entry in _declared_by(kind).read:
        name, reader = entry.name, entry.metadata[OPTION].read
        value = values.get(name, entry.default)
        if reader is not None and name in values:
            sources[name] = value
        if value is MISSING:
            continue
        fields[name] = value
        if reader is not None and name != "axis":
            deferred.append(entry)
            continue
        fields[name] = _read(entry, value, fields.get("axis"))
        if name == "axis":
            on_units(getattr(fields[name], "units", LINEAR))
    request = kind(**fields, given=frozenset(given), sources=sources, **more)
    records = {entry.name: _read(entry, fields[entry.name], fields.get("axis")) for entry in deferred}
    changed = {name: value for name, value in records.items() if value is not fields[name]}
    return dataclasses.replace(request, **changed) if changed else request


def _read(entry: Field[Any], value: Any, axis: Any) -> Any:
    """``value`` of a field; text and paths, also in a list, are replaced by what they are parsed or read to."""
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
    """Make ``function`` raise :class:`InputError` for text or None in place of a number, an axis or a record.

    >>> @typed
    ... def half(length: float) -> float:
    ...     return length / 2
    >>> half("3 mm")
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: `length`: found '3 mm', expected a number
    """
    signature = inspect.signature(function)
    kinds = _checkable_kinds(signature)

    @functools.wraps(function)
    def call(*arguments: Parameters.args, **named: Parameters.kwargs) -> Answer:
        _refuse_other_kinds(kinds, signature.bind(*arguments, **named).arguments)
        return function(*arguments, **named)

    return call


def _checkable_kinds(signature: inspect.Signature) -> dict[str, list[str]]:
    """The types of each parameter all of whose types are in ``KINDS``."""
    types = {name: str(each.annotation).split(" | ") for name, each in signature.parameters.items()}
    return {name: kinds for name, kinds in types.items() if set(kinds) <= KINDS.keys()}


def _refuse_other_kinds(checkable: Mapping[str, list[str]], values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        kinds = checkable.get(name)
        if kinds and (isinstance(value, str | Path) or (value is None and "None" not in kinds)):
            raise InputError(f"`{name}`: found {value!r}, expected {' or '.join(KINDS[kind] for kind in kinds)}")


def takes(kind: type[Request]) -> Callable[[Callable[..., Answer]], Callable[..., Answer]]:
    """Decorate a function whose last parameter is a request, so that it takes the fields of the request instead.

    ``help()`` shows every option with its unit and meaning. The function also accepts a request as such, and further
    keywords after it.

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
        checkable = {name: kinds for name, kinds in _checkable_kinds(signature).items() if name not in read}

        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Answer:
            if len(arguments) == len(before) + 1 and isinstance(arguments[-1], kind):
                return function(*arguments, **named)
            values = signature.bind(*arguments, **named).arguments
            _refuse_other_kinds(checkable, values)
            leading = [values.pop(parameter.name, parameter.default) for parameter in before]
            no_options = {name: value for name in others if (value := values.pop(name, None)) is not None}
            more = {name: value for parameter in after for name, value in values.pop(parameter.name, {}).items()}
            return function(*leading, make_request(kind, values, values, **no_options), **more)

        described: Any = call
        described.__signature__ = signature
        lines = [f"    {entry.name}: {entry.metadata[OPTION].help}" for entry in options_of(kind)]
        described.__doc__ = "\n".join([inspect.cleandoc(function.__doc__ or ""), "", "Options:", *lines])
        return call

    return decorate


def _around_request(function: Callable[..., Any]) -> tuple[list[inspect.Parameter], list[inspect.Parameter]]:
    """The parameters of ``function`` before its request, such as self, and after it: further keywords, if any."""
    parameters = list(inspect.signature(function).parameters.values())
    last = len(parameters) - (parameters[-1].kind is inspect.Parameter.VAR_KEYWORD)
    return parameters[: last - 1], parameters[last:]


def _signature(kind: type[Request], function: Callable[..., Any]) -> inspect.Signature:
    """The signature of ``function`` with the fields of ``kind`` in place of its request."""
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
    """The fields of ``kind`` that are no options and that a caller in Python may set."""
    internal = ("given", "sources", "overwrite")
    return [entry for entry in dataclasses.fields(kind) if OPTION not in entry.metadata and entry.name not in internal]


def types_of(kind: type[Request]) -> dict[str, Any]:
    """The type of each option on the command line."""
    typed = {entry.name: entry.metadata[OPTION].typed for entry in options_of(kind)}
    hints = get_type_hints(kind) if None in typed.values() else {}
    return {
        name: hints[name] if on_command_line is None else on_command_line for name, on_command_line in typed.items()
    }
