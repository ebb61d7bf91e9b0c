/* {{ name }}: {{ label }} of the axis "{{ axis }}"
 *
 * Made by emps-design {{ version }}; README.md documents the sources. Each sample, every {{ period }} s:
 *
{% for line in equations %} *     {{ line }}
{% endfor %} *
 * Double precision is bit-identical to the simulation if the compiler rounds every product and every sum: -ffp-contract=off, and no -ffast-math. With {{ macro }}_SINGLE defined all numbers are single precision.
 * C99 and math.h; no allocation, no other state than {{ name }}_state.
 */
#ifndef {{ macro }}_H
#define {{ macro }}_H

#ifdef __cplusplus
extern "C" {
#endif

#ifdef {{ macro }}_SINGLE
typedef float {{ name }}_real;
#else
typedef double {{ name }}_real;
#endif

#define {{ macro }}_PERIOD {{ period }} /* s, between two calls of {{ name }}_step */
#define {{ macro }}_MEMORY {{ memory }}

typedef struct {
    long long k; /* samples since {{ name }}_init */
    {{ name }}_real memory[{{ macro }}_MEMORY]; /* of the law, SI: values of the equations above at k-1, k-2, ... */
} {{ name }}_state;

/* Initialise: the next sample is the first, and the axis has been at rest until then. */
void {{ name }}_init({{ name }}_state *state);

/* One sample. Takes the reference of the law, {{ follows }} [{{ reference_unit }}], the position that the encoder reports
 * [{{ position_unit }}], and the external {{ force }} on the {{ carriage }} [{{ force_unit }}] (0 without a sensor).
 * Returns the {{ answer }} [{{ output_unit }}]{{ either_way }}.
{% if ahead %} *
 * ahead_q [{{ position_unit }}], ahead_v [{{ velocity_unit }}], ahead_a [{{ acceleration_unit }}]: the motion of the reference {{ ahead.wait }} s after
 * this sample, from which the feed-forward is computed: {{ ahead.terms | join(", ") }}.
{% endif %} */
{{ name }}_real {{ name }}_step({{ name }}_state *state, {{ name }}_real reference, {{ name }}_real q, {{ name }}_real f_ext{% if ahead %},
    {{ name }}_real ahead_q, {{ name }}_real ahead_v, {{ name }}_real ahead_a{% endif %});

#ifdef __cplusplus
}
#endif

#endif
