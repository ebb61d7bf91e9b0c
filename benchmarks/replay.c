/* The exact replay of emps_design.simulation.core in C: the yardstick of the benchmark, compiled where it runs. */
#include <math.h>

static void factors(double a, double h, double *e, double *g1, double *g2) {
    double x = a * h;
    if (x < 1e-3) {
        double s = 0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0)));
        *e = exp(-x); *g1 = h * (1.0 - x * s); *g2 = h * h * s;
    } else {
        *e = exp(-x); *g1 = -expm1(-x) / a; *g2 = (h - *g1) / a;
    }
}

/* b: mass, viscous, coulomb, offset; events: rows of time, kind, position; returns their number. */
long replay(long n, const double *reference, const double *b, double period, double gain, double limit, double kp,
            double kv, double q, double *position, double *encoder, double *velocity, double *u, double *events) {
    double mass = b[0], dry = b[2], offset = b[3], a = b[1] / mass, e, g1, g2;
    factors(a, period, &e, &g1, &g2);
    double m1 = g1 / mass, m2 = g2 / mass, proportional = kp * kv, damping = 0.5 * kv / period;
    double v = 0.0, last = q, older = q;
    long found = 0;
    for (long k = 0; k < n; k++) {
        double volts = proportional * (reference[k] - q) - damping * (q - older);
        older = last; last = q;
        if (volts > limit) volts = limit;
        if (volts < -limit) volts = -limit;
        position[k] = q; encoder[k] = q; velocity[k] = v; u[k] = volts;
        double net = gain * volts - offset;
        if (v > 0.0) {
            double f = net - dry, next = v * e + f * m1;
            if (next > 0.0) { q += v * g1 + f * m2; v = next; continue; }
        } else if (v < 0.0) {
            double f = net + dry, next = v * e + f * m1;
            if (next < 0.0) { q += v * g1 + f * m2; v = next; continue; }
        } else if (fabs(net) <= dry) {
            continue;
        }
        double at = 0.0, before = v, f1, f2, f0;
        if (v != 0.0) {
            double f = (v > 0.0 ? net - dry : net + dry) / mass;
            at = a > 0.0 ? log1p(-a * v / f) / a : -v / f;
            at = at < 0.0 ? 0.0 : (at > period ? period : at);
            factors(a, at, &f0, &f1, &f2);
            q += v * f1 + f * f2;
        }
        v = 0.0;
        if (fabs(net) > dry) {
            double f = (net > 0.0 ? net - dry : net + dry) / mass;
            factors(a, period - at, &f0, &f1, &f2);
            q += f * f2;
            v = f * f1;
        }
        events[3 * found] = k * period + at;
        events[3 * found + 1] = before != 0.0 ? (v == 0.0 ? 1.0 : 0.0) : 2.0;
        events[3 * found + 2] = q;
        found++;
    }
    return found;
}
