/* Velocity Verlet on the harmonic oscillator by compensated sums, writing the columns that a run record keeps of it. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

/* Add, and carry on what rounding takes from the sum. */
static inline double sum(double before, double added, double *carried) {
    added = added + *carried;
    double total = before + added;
    *carried = added - (total - before);
    return total;
}

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

int main(int count, char **words) {
    if (count != 2) return 2;
    long steps = atol(words[1]);
    double start = seconds();
    double m = 1.0, k = 4.0, h = 1e-3, x = 1.0, v = 0.0, x_carried = 0.0, v_carried = 0.0, f = -k * x, a = f / m;
    double *column[9];
    for (int i = 0; i < 9; i++) column[i] = malloc((steps + 1) * sizeof(double));
    char *kind = malloc(steps + 1), *regime = malloc(steps + 1);
    for (long n = 0; n <= steps; n++) {
        double used = 0.0;
        if (n) {
            x = sum(x, h * v + h * h / 2.0 * a, &x_carried);
            f = -(k * x);
            double after = f / m;
            v = sum(v, h / 2.0 * (a + after), &v_carried);
            a = after;
            used = h;
            if (!(isfinite(x) && isfinite(v) && isfinite(a))) return 1;
        }
        double kinetic = m / 2.0 * (v * v), potential = k * (x * x) / 2.0;
        double row[9] = {n * h, used, x, v, a, f, kinetic, potential, kinetic + potential};
        for (int i = 0; i < 9; i++) column[i][n] = row[i];
        kind[n] = n > 0;
        regime[n] = 0;
    }
    printf("%.9f %.17g\n", seconds() - start, column[2][steps]);
    return 0;
}
