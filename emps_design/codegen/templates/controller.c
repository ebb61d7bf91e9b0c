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
static const real LIMIT = R({{ limit }}); /* {{ command_unit }} */
static const real GAINS[{{ gains | length }}] = {
{% for value, comment in gains %}    R({{ value }}){{ "," if not loop.last else "" }}{{ " /* " ~ comment ~ " */" if comment else "" }}
{% endfor %}};

{% for definition in definitions %}{{ definition }}

{% endfor %}void {{ name }}_init({{ name }}_state *state)
{
    state->k = 0;
    for (int i = 0; i < {{ macro }}_MEMORY; i++) {
        state->memory[i] = R(0);
    }
}

real {{ name }}_step({{ name }}_state *state, real reference, real q, real f_ext)
{
    real u = {{ kernel }}(state->k, reference, q, f_ext, state->memory);

    state->k++;
    if (u > LIMIT) {
        u = LIMIT;
    } else if (u < -LIMIT) {
        u = -LIMIT;
    }
    return u;
}
