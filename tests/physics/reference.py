"""The plant integrated by scipy's DOP853 with events at tight tolerances: slow, plain, nothing shared with the engine.

Kernels are the effects' own Python functions, called as they are.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

APART = 5e-10  # s, the two sides of a jump in time
CROSSING = 1e-13  # s, the step over a guard's zero
HOOKS = ("force", "dry", "inertia", "sensor", "command", "delay", "rate")


class Reference:
    """Motion of an axis. Motion has a direction (+1, -1), rest is 0; friction that is a state is ``free``."""

    def __init__(self, axis):
        self.axis = axis
        self.b = axis.mechanics.array().tolist()  # plain numbers: many times as fast as those of an array
        self.gain = axis.drive.force_gain
        self.limit = axis.drive.command_limit
        self.period = axis.sampling.period
        self.effects = [one.effect for one in axis.effects]
        self.p = [one.effect.values(one.parameters).tolist() for one in axis.effects]
        self.at = (2 + np.cumsum([0] + [len(effect.states) for effect in self.effects])).tolist()
        self.free = any(effect.takes_dry for effect in self.effects)
        self.bounds = (-np.inf, np.inf)
        self.lags = [i for i, effect in enumerate(self.effects) if effect.solver.lag is not None]
        self.have = {hook: [i for i, effect in enumerate(self.effects) if effect.hook(hook)] for hook in HOOKS}

    def call(self, hook, i, t, y, tau):
        """One kernel of effect ``i``: a lag gets the force commanded, all others the force behind it."""
        if self.effects[i].solver.lag is None:
            tau = self.acting(t, y, tau)
        own = y[self.at[i] : self.at[i + 1]]
        return self.effects[i].hook(hook)(y[0], y[1], t, tau, own, self.p[i], self.b)

    def acting(self, t, y, tau):
        """Motor force [N] behind the lag, of which there is one at most here."""
        return tau - sum([self.call("force", i, t, y, tau) for i in self.lags])

    def total(self, hook, t, y, tau):
        t = min(max(t, self.bounds[0]), self.bounds[1])
        return sum([self.call(hook, i, t, y, tau) for i in self.have[hook]])

    def balance(self, t, y, tau):
        mass, viscous, coulomb, offset = self.b
        net = tau - viscous * y[1] - offset - self.total("force", t, y, tau)
        level = max(0.0, coulomb + self.total("dry", t, y, tau))
        return net, level, mass + self.total("inertia", t, y, tau)

    def slope(self, t, y, tau, s):
        dy, y = np.zeros_like(y), y.tolist()
        net, level, mass = self.balance(t, y, tau)
        if self.free:
            dy[:2] = y[1], net / mass
        elif s:
            dy[:2] = y[1], (net - s * level) / mass
        inside = min(max(t, self.bounds[0]), self.bounds[1])
        for i in self.have["rate"]:
            effect = self.effects[i]
            own, force = slice(self.at[i], self.at[i + 1]), self.acting(t, y, tau) if effect.solver.lag is None else tau
            effect.rate(y[0], y[1], inside, force, y[own], self.p[i], self.b, level, dy[own])
        return dy

    def leaves(self, t, y, tau):
        net, level, _ = self.balance(t, y, tau)
        return 0.0 if abs(net) <= level + 1e-12 else float(np.sign(net))

    def solve(self, t, end, y, tau, s, events=()):
        """One call of solve_ivp; ``events`` are terminal."""
        for event in events:
            event.terminal = True
        answer = solve_ivp(
            lambda t, y: self.slope(t, y, tau, s), (t, end), y,
            method="DOP853", rtol=3e-13, atol=1e-15, events=events or None, max_step=2e-3,
        )  # fmt: skip
        assert answer.success, answer.message
        return answer

    def events(self, tau, s):
        """What ends a stretch: the velocity's zero or break-away, then every guard."""
        if self.free:
            first = lambda t, y: 1.0  # noqa: E731
        elif s == 0.0:
            first = lambda t, y: (lambda net, level, _: level + 1e-12 - abs(net))(*self.balance(t, y, tau))  # noqa: E731
        else:
            first = lambda t, y: y[1]  # noqa: E731
        found = [first]
        for i, effect in enumerate(self.effects):
            if effect.solver.guard is not None:
                found.append(lambda t, y, i=i: self.call("guard", i, t, y, tau))
        return found

    def carry(self, t, end, y, tau, s):
        """Integrate to ``end`` under one motor force, from event to event."""
        if not self.free and y[1] == 0.0:
            s = self.leaves(t, y, tau)
        for _ in range(1000):
            if end - t <= 1e-15:
                return y, s
            if s and y[1] == 0.0:  # begin beyond the zero, or it would be found again
                tiny = min(1e-7, 0.5 * (end - t))
                y, t = self.solve(t, t + tiny, y, tau, s).y[:, -1], t + tiny
            answer = self.solve(t, end, y, tau, s, self.events(tau, s))
            t, y = answer.t[-1], answer.y[:, -1]
            if answer.status == 0:
                return y, s
            if len(answer.t_events[0]):
                if s:
                    y[1] = 0.0
                left = self.leaves(t, y, tau)
                if s == 0.0 and left == 0.0:
                    left = float(np.sign(self.balance(t, y, tau)[0]))
                s = left
            else:
                tiny = min(CROSSING, end - t)
                y, t = y + tiny * self.slope(t, y, tau, s), t + tiny
        raise AssertionError("more than 1000 events in a period")

    def sample(self, k, y, t, tau, q_ref):
        """Voltage of ``position_pd`` with its two-tap velocity, commands and sensor errors included."""
        seen = y[0] + self.total("sensor", t, y, tau)
        if k == 0:
            self.last = self.older = seen
        controller = self.axis.controller
        v = (seen - self.older) / (2.0 * self.period)
        self.older, self.last = self.last, seen
        volts = controller.kp * controller.kv * (q_ref - seen) - controller.kv * v + self.total("command", t, y, tau)
        return min(max(volts, -self.limit), self.limit)

    def positions(self, given, q0=0.0, v0=0.0, closed=False):
        """Positions [m] at the samples, from ``q0`` with ``v0``: ``given`` voltage [V], or q_ref [m] if ``closed``."""
        y = np.zeros(self.at[-1])
        y[:2] = q0, v0
        for i, effect in enumerate(self.effects):
            if effect.initial is not None:
                y[self.at[i] : self.at[i + 1]] = effect.initial(q0, self.p[i], self.b)
        positions, u, s, tau = np.empty(len(given)), np.array(given, dtype=float), np.sign(v0), 0.0
        for k in range(len(given)):
            t = k * self.period
            positions[k] = y[0]
            if closed:
                u[k] = self.sample(k, y, t, tau, given[k])
            wait = self.total("delay", t, y, tau)
            whole = int(np.floor(wait / self.period + 1e-9))
            first = wait - whole * self.period
            edges = [t, t + self.period] if first < 1e-12 else [t, t + first, t + self.period]
            for edge, end in pairwise(edges):
                j = k - whole - (1 if first >= 1e-12 and edge == t else 0)
                volts = u[j] if j >= 0 else 0.0
                for i, effect in enumerate(self.effects):
                    if effect.actuator is not None and j >= 0:
                        volts = effect.actuator(volts, self.p[i])
                tau = self.gain * volts
                y, s = self.between_jumps(edge, end, y, tau, s)
            self.bounds = (-np.inf, np.inf)
        return positions

    def between_jumps(self, start, end, y, tau, s):
        """Carry over [start, end], stopping where a kernel jumps in time."""
        while end - start > 1e-15:
            jumps = [
                self.call("jump_time", i, start + APART, y, tau)
                for i, effect in enumerate(self.effects)
                if effect.solver.jump_time is not None
            ]
            stop = min([end, *[jump for jump in jumps if jump > start]])
            self.bounds = (start + APART, stop - APART) if jumps else (-np.inf, np.inf)
            y, s = self.carry(start, stop, y, tau, s)
            start = stop
        return y, s
