"""The static maps between the voltage a controller asks for and the voltage that acts: dead zones, saturations.

A linear design needs the slope where the loop works. In steady motion the voltage that *acts* is known, from the force
that the motion takes; the command behind it is found by going back through the maps of the axis's effects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from emps_design.axis import Axis

EDGE = 0.99  # share of the largest voltage that acts at which a saturated map is looked at, from inside


@dataclass(frozen=True)
class ActuatorMap:
    """What becomes of a command [V] up to ``limit`` [V] on its way through ``maps``, in this order.

    >>> from emps_design.machines import machine
    >>> deadzone = {"kind": "actuator_deadzone", "width": 0.2}
    >>> found = ActuatorMap.of(machine("emps2018").replace(effects=[deadzone]))
    >>> round(found.acting(10.0), 6), round(found.command(0.5), 6), round(found.slope(0.0), 6)
    (9.8, 0.7, 1.0)
    """

    limit: float
    maps: tuple[Callable[[float], float], ...] = ()
    names: tuple[str, ...] = field(default=(), repr=False)

    @classmethod
    def of(cls, axis: Axis) -> ActuatorMap:
        """The maps of the effects of ``axis``, in their order."""
        found = [(entry.effect, entry.effect.values(entry.parameters)) for entry in axis.effects]
        found = [(effect, p) for effect, p in found if effect.actuator is not None]
        maps = tuple(lambda u, effect=effect, p=p: float(effect.actuator(u, p)) for effect, p in found)
        return cls(axis.drive.command_limit, maps, tuple(effect.name for effect, _ in found))

    def acting(self, command: float) -> float:
        """The voltage that acts [V] when ``command`` [V] is asked for."""
        for step in self.maps:
            command = step(command)
        return command

    def reach(self, acting: float) -> float:
        """``acting`` [V], or the largest voltage of its sign that acts within the limit, where that is smaller."""
        side = -1.0 if acting < 0.0 else 1.0
        return side * min(abs(acting), abs(self.acting(side * self.limit)))

    def command(self, acting: float) -> float:
        """The smallest command [V] with which ``acting`` [V] acts, as far as the limit lets it."""
        if not self.maps:
            return acting
        wanted, side = abs(self.reach(acting)), -1.0 if acting < 0.0 else 1.0
        low, high = 0.0, self.limit
        for _ in range(100):
            middle = 0.5 * (low + high)
            if abs(self.acting(side * middle)) < wanted:
                low = middle
            else:
                high = middle
        return side * high

    def slope(self, acting: float) -> float:
        """Change of the acting voltage with the command [V/V] at ``acting`` [V], or just inside the largest."""
        if not self.maps:
            return 1.0
        side = -1.0 if acting < 0.0 else 1.0
        inside = min(abs(acting), EDGE * abs(self.acting(side * self.limit)))
        step = 1e-3 * (self.acting(side * self.limit) * side - inside)
        if step <= 0.0:
            return 0.0
        # Away from zero, so that a dead zone is left behind and not straddled.
        near, far = (self.command(side * (inside + count * step)) for count in (1, 2))
        return step / abs(far - near)
