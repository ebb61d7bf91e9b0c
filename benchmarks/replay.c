/* The exact replay of emps_design.simulation.kernels.baseline in C: the yardstick of the benchmark, compiled where it runs. */
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

struct plant { double mass, dry, offset, a, period, e, g1, g2; };

static struct plant prepared(const double *b, double period) {
    struct plant p = {b[0], b[2], b[3], b[1] / b[0], period, 0.0, 0.0, 0.0};
    factors(p.a, period, &p.e, &p.g1, &p.g2);
    return p;
}

/* One period under the motor force tau; writes a row of events where the velocity reaches zero or leaves it. */
static inline long moved(const struct plant *p, double tau, long k, double *q, double *v, double *event) {
    double net = tau - p->offset, m1 = p->g1 / p->mass, m2 = p->g2 / p->mass;
    if (*v > 0.0) {
        double f = net - p->dry, next = *v * p->e + f * m1;
        if (next > 0.0) { *q += *v * p->g1 + f * m2; *v = next; return 0; }
    } else if (*v < 0.0) {
        double f = net + p->dry, next = *v * p->e + f * m1;
        if (next < 0.0) { *q += *v * p->g1 + f * m2; *v = next; return 0; }
    } else if (fabs(net) <= p->dry) {
        return 0;
    }
    double at = 0.0, before = *v, f1, f2, f0;
    if (*v != 0.0) {
        double f = (*v > 0.0 ? net - p->dry : net + p->dry) / p->mass;
        at = p->a > 0.0 ? log1p(-p->a * *v / f) / p->a : -*v / f;
        at = at < 0.0 ? 0.0 : (at > p->period ? p->period : at);
        factors(p->a, at, &f0, &f1, &f2);
        *q += *v * f1 + f * f2;
    }
    *v = 0.0;
    if (fabs(net) > p->dry) {
        double f = (net > 0.0 ? net - p->dry : net + p->dry) / p->mass;
        factors(p->a, p->period - at, &f0, &f1, &f2);
        *q += f * f2;
        *v = f * f1;
    }
    event[0] = k * p->period + at;
    event[1] = before != 0.0 ? (*v == 0.0 ? 1.0 : 0.0) : 2.0;
    event[2] = *q;
    return 1;
}

/* b: mass, viscous, coulomb, offset; events: rows of time, kind, position; returns their number. */
long replay(long n, const double *reference, const double *b, double period, double gain, double limit, double kp,
            double kv, double q, double *position, double *encoder, double *velocity, double *u, double *events) {
    struct plant p = prepared(b, period);
    double proportional = kp * kv, damping = 0.5 * kv / period, v = 0.0, last = q, older = q;
    long found = 0;
    for (long k = 0; k < n; k++) {
        double volts = proportional * (reference[k] - q) - damping * (q - older);
        older = last; last = q;
        if (volts > limit) volts = limit;
        if (volts < -limit) volts = -limit;
        position[k] = q; encoder[k] = q; velocity[k] = v; u[k] = volts;
        found += moved(&p, gain * volts, k, &q, &v, events + 3 * found);
    }
    return found;
}

struct filter { double b0, b1, b2, a1, a2, s1, s2; };

/* The cascade on the same plant: position loop in every n-th sample, PI, feed-forward, at most 8 filters, hold. */
long replay_cascade(long n, const double *reference, const double *b, double period, double gain, double limit,
                    double kp, long every, double kv, double ki, double share, double acceleration, double coulomb,
                    long filters, const double *coefficients, double q, double *position, double *encoder,
                    double *velocity, double *u, double *events) {
    struct plant p = prepared(b, period);
    struct filter chain[8];
    double v = 0.0, last = q, r1 = reference[0], r2 = reference[0], wanted = 0.0, integral = 0.0;
    long found = 0;
    for (long i = 0; i < filters; i++) {
        const double *c = coefficients + 5 * i;
        struct filter one = {c[0], c[1], c[2], c[3], c[4], 0.0, 0.0};
        chain[i] = one;
    }
    for (long k = 0; k < n; k++) {
        double r = reference[k], speed = (q - last) / period;
        double vr = (r - r1) / period, ar = (r - 2.0 * r1 + r2) / (period * period);
        last = q; r2 = r1; r1 = r;
        if (k % every == 0) wanted = kp * (r - q);
        double e = wanted + share * vr - speed, next = integral + ki * e;
        double w = kv * e + next + acceleration * ar + (vr > 0.0 ? coulomb : vr < 0.0 ? -coulomb : 0.0);
        for (long i = 0; i < filters; i++) {
            struct filter *f = chain + i;
            double y = f->b0 * w + f->s1;
            f->s1 = f->b1 * w - f->a1 * y + f->s2;
            f->s2 = f->b2 * w - f->a2 * y;
            w = y;
        }
        double command = w > limit ? limit : w < -limit ? -limit : w;
        if (command == w) integral = next;
        position[k] = q; encoder[k] = q; velocity[k] = v; u[k] = command;
        found += moved(&p, gain * command, k, &q, &v, events + 3 * found);
    }
    return found;
}
