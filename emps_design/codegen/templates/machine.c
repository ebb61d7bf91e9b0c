/* Made by emps-design {{ version }}: the axis "{{ axis }}" with its effects, translated from the stepper of its
 * simulations. Doubles; bit-identical if the compiler rounds every product and every sum: -ffp-contract=off.
 */
#include <math.h>
#include <string.h>

typedef double real;

#define R(x) ((real)(x))
#define FN(name) name
#define RING {{ machine.ring }} /* stored samples */

{% for line in machine.structures %}{{ line }}
{% endfor %}
{% for definition in machine.functions %}{{ definition }}

{% endfor %}/* The kernels of the effects by their numbers. */
static real call_kernel(long long which, real q, real v, real t, real tau, real *x, long long x_at, real *p, long long p_at, real *b)
{
    (void)q; (void)v; (void)t; (void)tau; (void)x; (void)x_at; (void)p; (void)p_at; (void)b;
    switch (which) {
{% for number, kernel in machine.kernels["kernel"] %}    case {{ number }}:
        return {{ kernel }}(q, v, t, tau, x + x_at, p + p_at, b);
{% endfor %}    default:
        return R(0.0);
    }
}

static real call_actuator(long long which, real u, real *p, long long p_at)
{
    (void)p; (void)p_at;
    switch (which) {
{% for number, kernel in machine.kernels["actuator"] %}    case {{ number }}:
        return {{ kernel }}(u, p + p_at);
{% endfor %}    default:
        return u;
    }
}

static void call_rate(long long which, real q, real v, real t, real tau, real *x, long long x_at, real *p, long long p_at, real *b, real level, real *dx)
{
    (void)q; (void)v; (void)t; (void)tau; (void)x; (void)x_at; (void)p; (void)p_at; (void)b; (void)level; (void)dx;
    switch (which) {
{% for number, kernel in machine.kernels["rate"] %}    case {{ number }}:
        {{ kernel }}(q, v, t, tau, x + x_at, p + p_at, b, level, dx + x_at);
        break;
{% endfor %}    default:
        break;
    }
}

{% for definition in machine.stepping %}{{ definition }}

{% endfor %}static const real BASELINE[] = { {{- machine.numbers["baseline"] | join(", ") -}} }; /* mass, viscous, Coulomb, offset */
static const real PARAMETERS[] = { {{- machine.numbers["parameters"] | join(", ") -}} };
static const real SETTINGS[] = { {{- machine.numbers["settings"] | join(", ") -}} };
static const real FLOORS[] = { {{- machine.numbers["floors"] | join(", ") -}} };
static const long long HOOKS[] = { {{- machine.numbers["hooks"] | join(", ") -}} };
static const long long STARTS[] = { {{- machine.numbers["starts"] | join(", ") -}} };

/* The variables of the run, and the arrays that they point into. */
typedef struct {
{% for line in machine.opened.fields %}    {{ line }}
{% endfor %}    real own_b[sizeof BASELINE / sizeof *BASELINE];
    real own_p[sizeof PARAMETERS / sizeof *PARAMETERS];
    real own_settings[sizeof SETTINGS / sizeof *SETTINGS];
    real own_floors[sizeof FLOORS / sizeof *FLOORS];
    long long own_hooks[sizeof HOOKS / sizeof *HOOKS];
    long long own_starts[sizeof STARTS / sizeof *STARTS];
    long long own_tally[2];
    real own_y[{{ machine.numbers["y"] | length }}];
    real own_scratch[{{ machine.numbers["scratch"][0] }}];
    real own_out[5 * RING];
    real own_reference[RING];
    real own_push[RING];
} run_state;

enum { TIME, U, F_EXT, Q, POSITION, V, Q_START, VALUES, PARAMETER = Q_START };
static const double START[VALUES] = {0};
typedef run_state model;

/* A sample up to what the encoder reports. */
static void read_encoder(run_state *m)
{
{% for line in machine.opened.upto %}{{ line }}
{% endfor %}}

/* The rest of a sample: the command acts for one period. Its status is 0 without an error. */
static {{ machine.opened.result }}move(run_state *m)
{
{% for line in machine.opened.after %}{{ line }}
{% endfor %}}

/* At rest at q0. */
static void begin(run_state *m, real q0)
{
    static const run_state NOTHING;

    *m = NOTHING;
    memcpy(m->own_b, BASELINE, sizeof BASELINE);
    memcpy(m->own_p, PARAMETERS, sizeof PARAMETERS);
    memcpy(m->own_settings, SETTINGS, sizeof SETTINGS);
    memcpy(m->own_floors, FLOORS, sizeof FLOORS);
    memcpy(m->own_hooks, HOOKS, sizeof HOOKS);
    memcpy(m->own_starts, STARTS, sizeof STARTS);
    m->own_y[0] = q0;
{% for function, kind, at, parameters, size in machine.initial %}    {
        {{ kind }} first = {{ function }}(q0, m->own_p + {{ parameters }}, m->own_b);

{% for i in range(size) %}        m->own_y[{{ at + i }}] = first.f{{ i }};
{% endfor %}    }
{% endfor %}    m->arrays.f0 = m->own_b;
    m->arrays.f1 = m->own_hooks;
    m->arrays.f2 = m->own_starts;
    m->arrays.f3 = m->own_p;
    m->arrays.f4 = m->own_settings;
    m->y = m->own_y;
    m->floors = m->own_floors;
    m->scratch = m->own_scratch;
    m->out = m->own_out;
    m->reference = m->own_reference;
    m->push = m->own_push;
    m->tally = m->own_tally;
{% for line in machine.opened.before %}{{ line }}
{% endfor %}}

static void tell(run_state *m, double *value)
{
    read_encoder(m);
    value[Q] = m->encoder[m->k % RING];
    value[POSITION] = m->position[m->k % RING];
    value[V] = m->velocity[m->k % RING];
}

static void model_begin(model *m, double *value)
{
    begin(m, value[Q_START]);
    tell(m, value);
}

static int model_step(model *m, double *value)
{
    m->reference[m->k % RING] = value[U];
    m->push[m->k % RING] = value[F_EXT];
    if (move(m).f0 != 0) {
        return 0;
    }
    m->k++;
    tell(m, value);
    return 1;
}
