/* Made by emps-design {{ version }}: {{ label }}; see {{ name }}.h. */
#include "{{ name }}.h"

{% if uses_math %}#include <math.h>

{% endif %}typedef {{ name }}_real real;

#define R(x) ((real)(x))
{% if uses_math %}#ifdef {{ macro }}_SINGLE
#define FN(name) name##f
#else
#define FN(name) name
#endif
{% endif %}
/* Parameters of the axis file:
{% for line in parameters %} *     {{ line }}
{% endfor %} */
static const real LIMIT = R({{ limit }}); /* {{ output_unit }} */
static const real GAINS[{{ gains | length }}] = {
{% for value, comment in gains %}    R({{ value }}){{ "," if not loop.last else "" }}{{ " /* " ~ comment ~ " */" if comment else "" }}
{% endfor %}};

{% for definition in definitions %}{{ definition }}

{% endfor %}{% if ahead %}/* Command for the motion of the reference, by the model [{{ command_unit }}]. */
static real {{ name }}_feedforward(real q, real v, real a)
{
    real direction = {% if ahead.reversal %}v / R({{ ahead.reversal }}){% else %}R(0.0){% endif %};
    real tau = R(0.0);

    (void)q;
    direction = direction > R(1.0) ? R(1.0) : direction;
    direction = direction < R(-1.0) ? R(-1.0) : direction;
{% if ahead.repeats %}    for (int pass = 0; pass < {{ ahead.passes }}; pass++) { /* a friction that depends on the force itself */
        real before = tau;
{% endif %}{% for hook in ahead.hooks %}    real {{ hook.name }} = R(0.0){% for call in hook.calls %} + {{ call }}(q, v, tau){% endfor %};
{% endfor %}    real mass = R({{ ahead.own[0] }}) + inertia; /* {{ mass_unit }} */
    real level = R({{ ahead.own[2] }}) + dry; /* {{ force_unit }}, of dry friction */

    level = level > R(0.0) ? level : R(0.0);
    tau = R({{ ahead.own[1] }}) * v + R({{ ahead.own[3] }}) + force;
    tau = tau + (mass * a + level * direction);
{% if ahead.repeats %}    if (FN(fabs)(tau - before) < R(1e-10)) {
        break;
    }
    }
{% endif %}    return {% if ahead.back_emf %}(tau + R({{ ahead.back_emf }}) * v){% else %}tau{% endif %} / R({{ ahead.gain }});
}

{% endif %}void {{ name }}_init({{ name }}_state *state)
{
    state->k = 0;
    for (int i = 0; i < {{ macro }}_MEMORY; i++) {
        state->memory[i] = R(0);
    }
}

real {{ name }}_step({{ name }}_state *state, real reference, real q, real f_ext{% if ahead %}, real ahead_q, real ahead_v, real ahead_a{% endif %})
{
{% if ahead %}{% if waits is not none %}    real integral = state->memory[{{ waits }}];
{% endif %}    /* The law acts on the position error only. */
    real u = {{ kernel }}(state->k, R(0.0), q - reference, f_ext, state->memory);

    u = u + {{ name }}_feedforward(ahead_q, ahead_v, ahead_a);
{% else %}    real u = {{ kernel }}(state->k, reference, q, f_ext, state->memory);

{% endif %}    state->k++;
    if (u > LIMIT) {
        u = LIMIT;
{% if waits is not none %}        state->memory[{{ waits }}] = integral;
{% endif %}    } else if (u < -LIMIT) {
        u = -LIMIT;
{% if waits is not none %}        state->memory[{{ waits }}] = integral;
{% endif %}    }
    return u;
}
