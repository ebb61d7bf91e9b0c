/* Made by emps-design. Runs {{ name }} on vectors.csv: the same bits in double precision, within the bound of each row in single. */
#include "{{ name }}.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define TIMED 1000000 /* steps */

#define INPUTS {{ inputs }}
#define COLUMNS (3 + INPUTS + {{ memories }})
#define LONGEST 4096

int main(int count, char **names)
{
    static char line[LONGEST];
    {{ name }}_state state;
    double largest = 0.0, bound = 0.0;
    long row = 0, wrong = 0, unbounded = 0;
    FILE *file = fopen(count > 1 ? names[1] : "vectors.csv", "r");

    if (file == NULL || fgets(line, LONGEST, file) == NULL) {
        fprintf(stderr, "vectors.csv cannot be read\n");
        return 2;
    }
    {{ name }}_init(&state);
    while (fgets(line, LONGEST, file) != NULL) {
        double value[COLUMNS];
        char *at = line;
        int bad;

        row++;
        for (int i = 0; i < COLUMNS; i++) {
            char *end;

            value[i] = strtod(at, &end);
            if (end == at) {
                fprintf(stderr, "vectors.csv, row %ld: found too few numbers\n", row);
                fclose(file);
                return 2;
            }
            at = *end == ',' ? end + 1 : end;
        }
        if (value[0] > 0.0) {
            {{ name }}_init(&state);
        }
        double u = (double){{ name }}_step(&state{% for i in range(1, inputs + 1) %}, ({{ name }}_real)value[{{ i }}]{% endfor %});
        double expected = value[INPUTS + 1], within = value[INPUTS + 2];
        double apart = fabs(u - expected);
#ifdef {{ macro }}_SINGLE
        bad = !(apart <= within);
        if (within < HUGE_VAL) {
            largest = apart > largest ? apart : largest;
            bound = within > bound ? within : bound;
        } else {
            unbounded++;
        }
#else
        largest = apart > largest ? apart : largest;
        (void)within;
        bad = memcmp(&u, &expected, sizeof u) != 0;
        for (int i = 0; i < {{ memories }}; i++) {
            double memory = (double)state.memory[i];
            bad = bad || memcmp(&memory, &value[3 + INPUTS + i], sizeof memory) != 0;
        }
#endif
        if (bad && wrong++ == 0) {
            fprintf(stderr, "vectors.csv, row %ld: found u = %.17g, expected %.17g\n", row, u, expected);
        }
    }
    fclose(file);
    clock_t begin = clock();
    volatile {{ name }}_real kept = 0;

    {{ name }}_init(&state);
    for (long i = 0; i < TIMED; i++) {
        kept = {{ name }}_step(&state{% for i in range(1, inputs + 1) %}, ({{ name }}_real)((double)(i % 100) * 1e-4){% endfor %});
    }
    (void)kept;
    printf("%.1f ns for one step here\n", 1e9 * (double)(clock() - begin) / (double)CLOCKS_PER_SEC / TIMED);
#ifdef {{ macro }}_SINGLE
    printf("single precision: %ld of %ld rows within their bound; largest difference %.3g, largest bound %.3g, %ld rows without\n",
           row - wrong, row, largest, bound, unbounded);
#else
    (void)bound;
    (void)unbounded;
    printf("double precision: %ld of %ld rows with the same bits; largest difference %.3g\n", row - wrong, row, largest);
#endif
    return row == 0 || wrong != 0;
}
