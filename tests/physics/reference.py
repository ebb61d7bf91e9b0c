"""The plant integrated by scipy's DOP853 with events at tight tolerances: slow, plain, and nothing shared with the engine.

Kernels are the effects' own Python functions, called as they are.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

APART = 5e-10  # s, the two sides of a jump in time


class Reference:
    """Open-loop motion of an axis; motion has a direction (+1, -1), rest is 0, friction in a state is "free"."""

    def __init__(self, axis):
        self.b = axis.mechanics.array()
        self.gain = axis.drive.force_gain
        self.period = axis.sampling.period
        self.effects = [one.effect for one in axis.effects]
        self.p = [one.effect.values(one.parameters) for one in axis.effects]
        self.at = 2 + np.cumsum([0] + [len(effect.states) for effect in self.effects])
        self.free = any(effect.takes_dry for effect in self.effects)
        self.bounds = (-np.inf, np.inf)

    def own(self, y, i):
        return y[self.at[i] : self.at[i + 1]]

    def sum(self, hook, t, y, tau):
        t = min(max(t, self.bounds[0]), self.bounds[1])
        return sum(
            getattr(effect, hook)(y[0], y[1], t, tau, self.own(y, i), self.p[i], self.b)
            for i, effect in enumerate(self.effects)
            if getattr(effect, hook) is not None
        )

    def balance(self, t, y, tau):
        mass, viscous, coulomb, offset = self.b
        net = tau - viscous * y[1] - offset - self.sum("force", t, y, tau)
        level = max(0.0, coulomb + self.sum("dry", t, y, tau))
        return net, level, mass + self.sum("inertia", t, y, tau)

    def slope(self, t, y, tau, s):
        net, level, mass = self.balance(t, y, tau)
        dy = np.zeros_like(y)
        if self.free:
            dy[:2] = y[1], net / mass
        elif s:
            dy[:2] = y[1], (net - s * level) / mass
        for i, effect in enumerate(self.effects):
            if effect.rate is not None:
                change = np.zeros(len(effect.states))
                inside = min(max(t, self.bounds[0]), self.bounds[1])
                effect.rate(y[0], y[1], inside, tau, self.own(y, i), self.p[i], self.b, level, change)
                dy[self.at[i] : self.at[i + 1]] = change
        return dy

    def leaves(self, t, y, tau):
        net, level, _ = self.balance(t, y, tau)
        return 0.0 if abs(net) <= level + 1e-12 else float(np.sign(net))

    def carry(self, t, end, y, tau, s):
        """Integrate to ``end`` under one motor force, from event to event."""
        if not self.free and y[1] == 0.0:
            s = self.leaves(t, y, tau)
        for _ in range(1000):
            if end - t <= 1e-15:
                return y, s
            zero = lambda t, y: y[1]  # noqa: E731
            slack = lambda t, y: (lambda net, level, _: level + 1e-12 - abs(net))(*self.balance(t, y, tau))  # noqa: E731
            never = lambda t, y: 1.0  # noqa: E731
            events = [never if self.free else slack if s == 0.0 else zero]
            for i, effect in enumerate(self.effects):
                if effect.guard is not None:
                    events.append(
                        lambda t, y, i=i, e=effect: e.guard(y[0], y[1], t, tau, self.own(y, i), self.p[i], self.b)
                    )
            for event in events:
                event.terminal = True
            if s and y[1] == 0.0:  # begin beyond the zero, or it would be found again
                tiny = min(1e-7, 0.5 * (end - t))
                y = y + 0.0
                solution = solve_ivp(
                    lambda t, y: self.slope(t, y, tau, s), (t, t + tiny), y, method="DOP853", rtol=1e-12, atol=1e-16
                )
                t, y = t + tiny, solution.y[:, -1]
            solution = solve_ivp(
                lambda t, y: self.slope(t, y, tau, s),
                (t, end),
                y,
                method="DOP853",
                rtol=3e-13,
                atol=1e-15,
                events=events,
                max_step=1e-3,
            )
            assert solution.success, solution.message
            t, y = solution.t[-1], solution.y[:, -1]
            if solution.status == 0:
                return y, s
            if len(solution.t_events[0]):
                if s:
                    y[1] = 0.0
                left = self.leaves(t, y, tau)
                if s == 0.0 and left == 0.0:
                    left = float(np.sign(self.balance(t, y, tau)[0]))
                s = left
            else:
                tiny = min(1e-13, end - t)  # step over the guard's zero
                y, t = y + tiny * self.slope(t, y, tau, s), t + tiny
        raise AssertionError("more than 1000 events in a period")

    def positions(self, u, q0=0.0):
        """Positions [m] at the samples of the voltage ``u`` [V], from rest at ``q0``."""
        y = np.zeros(self.at[-1])
        y[0] = q0
        for i, effect in enumerate(self.effects):
            if effect.initial is not None:
                y[self.at[i] : self.at[i + 1]] = effect.initial(q0, self.p[i], self.b)
        positions, s, tau = np.empty(len(u)), 0.0, 0.0
        for k in range(len(u)):
            t = k * self.period
            positions[k] = y[0]
            wait = self.sum("delay", t, y, tau)
            whole = int(np.floor(wait / self.period + 1e-9))
            first = wait - whole * self.period
            edges = [t, t + self.period] if first < 1e-12 else [t, t + first, t + self.period]
            for edge, end in zip(edges, edges[1:], strict=False):
                j = k - whole - (1 if first >= 1e-12 and edge == t else 0)
                volts = u[j] if j >= 0 else 0.0
                for i, effect in enumerate(self.effects):
                    if effect.actuator is not None and j >= 0:
                        volts = effect.actuator(volts, self.p[i])
                tau = self.gain * volts
                while end - edge > 1e-15:
                    jumps = [
                        effect.jump_time(y[0], y[1], edge + APART, tau, self.own(y, i), self.p[i], self.b)
                        for i, effect in enumerate(self.effects)
                        if effect.jump_time is not None
                    ]
                    stop = min([end, *[jump for jump in jumps if jump > edge]])
                    self.bounds = (edge + APART, stop - APART) if jumps else (-np.inf, np.inf)
                    y, s = self.carry(edge, stop, y, tau, s)
                    edge = stop
            self.bounds = (-np.inf, np.inf)
        return positions
