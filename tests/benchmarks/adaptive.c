/* Adaptive marches by hand: Dormand-Prince 5(4) and DOP853 on three problems of two coordinates, with a full log.

   adaptive problem method tolerance [end]
       problem    arenstorf, kepler or double_pendulum, each with its own end where none is given
       method     dormand_prince or dop853
   prints     least seconds, median seconds, accepted steps, rejected trials, force evaluations, final state (4)

   Build: cc -std=c99 -D_POSIX_C_SOURCE=199309L -O3 -march=native -ffp-contract=off adaptive.c -o adaptive -lm
   Coefficients and first step: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, sections II.4, II.5
   and II.10, and the authors' programs dopri5.f and dop853.f; here the error norm is the largest component. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { N = 2, M = 2 * N, COLUMNS = 2 + 4 * N + 1 + M, ROWS = 400037, MOST_REPEATS = 4001 };

/* Log: t, h, q, v, a, Q, error norm, error estimate by component. Rejected trials: t, h, error norm. Allocated once, or
   anew for every run to an end that is given. */
static double *column[COLUMNS], *trial[3];
static double q_force[N]; /* generalized forces at the last evaluation */
static volatile double given_mass = 1.0; /* a parameter, as in a model: the compiler does not know it */
static double mass;

typedef void Rates(const double *restrict y, double *restrict dy);

static inline __attribute__((always_inline)) void arenstorf(const double *restrict y, double *restrict dy) {
    const double mu = 0.012277471, mup = 1.0 - mu;
    double e = y[0] + mu, f = y[0] - mup, yy = y[1] * y[1];
    double d1 = e * e + yy, d2 = f * f + yy;
    double k1 = mup / (d1 * sqrt(d1)), k2 = mu / (d2 * sqrt(d2));
    dy[0] = y[2];
    dy[1] = y[3];
    q_force[0] = mass * (y[0] + 2.0 * y[3] - k1 * e - k2 * f);
    q_force[1] = mass * (y[1] - 2.0 * y[2] - (k1 + k2) * y[1]);
    dy[2] = q_force[0] / mass;
    dy[3] = q_force[1] / mass;
}

static inline __attribute__((always_inline)) void kepler(const double *restrict y, double *restrict dy) {
    double r2 = y[0] * y[0] + y[1] * y[1], k = -1.0 / (r2 * sqrt(r2));
    dy[0] = y[2];
    dy[1] = y[3];
    q_force[0] = mass * k * y[0];
    q_force[1] = mass * k * y[1];
    dy[2] = q_force[0] / mass;
    dy[3] = q_force[1] / mass;
}

static inline __attribute__((always_inline)) void double_pendulum(const double *restrict y, double *restrict dy) {
    const double g = 9.81; /* unit masses and lengths: mass matrix [[2, c], [c, 1]] */
    double s = sin(y[0] - y[1]), c = cos(y[0] - y[1]);
    double q1 = -s * (y[3] * y[3]) - 2.0 * g * sin(y[0]), q2 = s * (y[2] * y[2]) - g * sin(y[1]);
    double k = 1.0 / (2.0 - c * c);
    q_force[0] = q1;
    q_force[1] = q2;
    dy[0] = y[2];
    dy[1] = y[3];
    dy[2] = k * (q1 - c * q2);
    dy[3] = k * (2.0 * q2 - c * q1);
}

typedef struct {
    long accepted, rejected, evaluations;
    double y[M];
} Result;

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

static inline double larger(double a, double b) { return a > b ? a : b; }

static inline double clipped(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

/* The largest component of an error over its tolerance; the square root of nothing. */
static inline double norm_of(const double *e, const double *y0, const double *y1, double tol) {
    double norm = 0.0;
    for (int i = 0; i < M; i++) {
        double one = fabs(e[i]) / (tol + tol * larger(fabs(y0[i]), fabs(y1[i])));
        norm = one > norm || one != one ? one : norm;
    }
    return norm;
}

static inline void note(long n, double t, double h, const double *y, const double *dy, double norm, const double *e) {
    column[0][n] = t;
    column[1][n] = h;
    for (int i = 0; i < M; i++) column[2 + i][n] = y[i];
    for (int i = 0; i < N; i++) column[2 + M + i][n] = dy[N + i];
    for (int i = 0; i < N; i++) column[2 + M + N + i][n] = q_force[i];
    column[2 + 2 * M][n] = norm;
    for (int i = 0; i < M; i++) column[3 + 2 * M + i][n] = e[i];
}

/* The first step of section II.4, in the norm and the units of time of the march; one evaluation. */
static inline __attribute__((always_inline)) double first_step(Rates rates, const double *y, const double *k,
                                                               double tol, double order, double end) {
    double d[M], y1[M], k1[M], force[N];
    memcpy(force, q_force, sizeof force);
    double d0 = norm_of(y, y, y, tol), d1 = norm_of(k, y, y, tol), T = d0 / d1;
    double h0 = fmin(0.01 * T, end);
    for (int i = 0; i < M; i++) y1[i] = y[i] + h0 * k[i];
    rates(y1, k1);
    memcpy(q_force, force, sizeof force);
    for (int i = 0; i < M; i++) d[i] = (k1[i] - k[i]) / h0;
    double d2 = norm_of(d, y, y, tol);
    T = larger(T, sqrt(d0 / d2));
    return fmin(T * fmin(1.0, pow(0.01 / larger(d1 * T, d2 * T * T), 1.0 / order)), end);
}

#define EACH for (int i = 0; i < M; i++)
#define STAGE(k, sum) EACH w[i] = y[i] + h * (sum); rates(w, k)

/* One Dormand-Prince step: y1, k7 = f(y1) and the error estimate from y and k1 = f(y). */
static inline __attribute__((always_inline)) double dormand_prince(Rates rates, const double *y, const double *k1,
                                                                   double h, double tol, double *y1, double *k7,
                                                                   double *e) {
    double w[M], k2[M], k3[M], k4[M], k5[M], k6[M];
    STAGE(k2, 1.0 / 5 * k1[i]);
    STAGE(k3, 3.0 / 40 * k1[i] + 9.0 / 40 * k2[i]);
    STAGE(k4, 44.0 / 45 * k1[i] - 56.0 / 15 * k2[i] + 32.0 / 9 * k3[i]);
    STAGE(k5, 19372.0 / 6561 * k1[i] - 25360.0 / 2187 * k2[i] + 64448.0 / 6561 * k3[i] - 212.0 / 729 * k4[i]);
    STAGE(k6, 9017.0 / 3168 * k1[i] - 355.0 / 33 * k2[i] + 46732.0 / 5247 * k3[i] + 49.0 / 176 * k4[i]
                  - 5103.0 / 18656 * k5[i]);
    EACH y1[i] = y[i] + h * (35.0 / 384 * k1[i] + 500.0 / 1113 * k3[i] + 125.0 / 192 * k4[i] - 2187.0 / 6784 * k5[i]
                             + 11.0 / 84 * k6[i]);
    rates(y1, k7);
    EACH e[i] = h * (71.0 / 57600 * k1[i] - 71.0 / 16695 * k3[i] + 71.0 / 1920 * k4[i] - 17253.0 / 339200 * k5[i]
                     + 22.0 / 525 * k6[i] - 1.0 / 40 * k7[i]);
    return norm_of(e, y, y1, tol);
}

/* One DOP853 step: y1 and the error estimate; the caller evaluates f(y1) once it accepts. */
static inline __attribute__((always_inline)) double dop853(Rates rates, const double *y, const double *k1, double h,
                                                           double tol, double *y1, double *unused, double *e) {
    double w[M], k2[M], k3[M], k4[M], k5[M], k6[M], k7[M], k8[M], k9[M], k10[M], k11[M], k12[M];
    (void)unused;
    STAGE(k2, 5.26001519587677318785587544488e-2 * k1[i]);
    STAGE(k3, 1.97250569845378994544595329183e-2 * k1[i] + 5.91751709536136983633785987549e-2 * k2[i]);
    STAGE(k4, 2.95875854768068491816892993775e-2 * k1[i] + 8.87627564304205475450678981324e-2 * k3[i]);
    STAGE(k5, 2.41365134159266685502369798665e-1 * k1[i] - 8.84549479328286085344864962717e-1 * k3[i]
                  + 9.24834003261792003115737966543e-1 * k4[i]);
    STAGE(k6, 3.7037037037037037037037037037e-2 * k1[i] + 1.70828608729473871279604482173e-1 * k4[i]
                  + 1.25467687566822425016691814123e-1 * k5[i]);
    STAGE(k7, 3.7109375e-2 * k1[i] + 1.70252211019544039314978060272e-1 * k4[i]
                  + 6.02165389804559606850219397283e-2 * k5[i] - 1.7578125e-2 * k6[i]);
    STAGE(k8, 3.70920001185047927108779319836e-2 * k1[i] + 1.70383925712239993810214054705e-1 * k4[i]
                  + 1.07262030446373284651809199168e-1 * k5[i] - 1.53194377486244017527936158236e-2 * k6[i]
                  + 8.27378916381402288758473766002e-3 * k7[i]);
    STAGE(k9, 6.24110958716075717114429577812e-1 * k1[i] - 3.36089262944694129406857109825 * k4[i]
                  - 8.68219346841726006818189891453e-1 * k5[i] + 2.75920996994467083049415600797e1 * k6[i]
                  + 2.01540675504778934086186788979e1 * k7[i] - 4.34898841810699588477366255144e1 * k8[i]);
    STAGE(k10, 4.77662536438264365890433908527e-1 * k1[i] - 2.48811461997166764192642586468 * k4[i]
                   - 5.90290826836842996371446475743e-1 * k5[i] + 2.12300514481811942347288949897e1 * k6[i]
                   + 1.52792336328824235832596922938e1 * k7[i] - 3.32882109689848629194453265587e1 * k8[i]
                   - 2.03312017085086261358222928593e-2 * k9[i]);
    STAGE(k11, -9.3714243008598732571704021658e-1 * k1[i] + 5.18637242884406370830023853209 * k4[i]
                   + 1.09143734899672957818500254654 * k5[i] - 8.14978701074692612513997267357 * k6[i]
                   - 1.85200656599969598641566180701e1 * k7[i] + 2.27394870993505042818970056734e1 * k8[i]
                   + 2.49360555267965238987089396762 * k9[i] - 3.0467644718982195003823669022 * k10[i]);
    STAGE(k12, 2.27331014751653820792359768449 * k1[i] - 1.05344954667372501984066689879e1 * k4[i]
                   - 2.00087205822486249909675718444 * k5[i] - 1.79589318631187989172765950534e1 * k6[i]
                   + 2.79488845294199600508499808837e1 * k7[i] - 2.85899827713502369474065508674 * k8[i]
                   - 8.87285693353062954433549289258 * k9[i] + 1.23605671757943030647266201528e1 * k10[i]
                   + 6.43392746015763530355970484046e-1 * k11[i]);
    double e3[M], e5[M];
    EACH {
        double sum = 5.42937341165687622380535766363e-2 * k1[i] + 4.45031289275240888144113950566 * k6[i]
                     + 1.89151789931450038304281599044 * k7[i] - 5.8012039600105847814672114227 * k8[i]
                     + 3.1116436695781989440891606237e-1 * k9[i] - 1.52160949662516078556178806805e-1 * k10[i]
                     + 2.01365400804030348374776537501e-1 * k11[i] + 4.47106157277725905176885569043e-2 * k12[i];
        y1[i] = y[i] + h * sum;
        e3[i] = h * (sum - 0.244094488188976377952755905512 * k1[i] - 0.733846688281611857341361741547 * k9[i]
                     - 0.220588235294117647058823529412e-1 * k12[i]);
        e5[i] = h * (0.1312004499419488073250102996e-1 * k1[i] - 0.1225156446376204440720569753e1 * k6[i]
                     - 0.4957589496572501915214079952 * k7[i] + 0.1664377182454986536961530415e1 * k8[i]
                     - 0.3503288487499736816886487290 * k9[i] + 0.3341791187130174790297318841 * k10[i]
                     + 0.8192320648511571246570742613e-1 * k11[i] - 0.2235530786388629525884427845e-1 * k12[i]);
        double third = e3[i] * 0.1, whole = sqrt(e5[i] * e5[i] + third * third);
        e[i] = whole > 0.0 ? e5[i] * (fabs(e5[i]) / whole) : 0.0;
    }
    return norm_of(e, y, y1, tol);
}

typedef double Step(Rates, const double *, const double *, double, double, double *, double *, double *);

/* The whole march. `order` is the controller's, `beta` the weight of the last error, `fsal` whether k at y1 is known. */
static inline __attribute__((always_inline)) Result march(Rates rates, Step step, int stages, double order, double beta,
                                                          int fsal, const double *start, double end, double tol) {
    Result r = {0};
    double y[M], y1[M], k[M], k1[M], e[M] = {0}, t = 0.0, alpha = 1.0 / order - 0.75 * beta, before = 1e-4;
    int last = 0, after_rejection = 0;
    EACH y[i] = start[i];
    rates(y, k);
    double h = first_step(rates, y, k, tol, order, end);
    r.evaluations = 2;
    note(0, t, 0.0, y, k, 0.0, e);
    while (!last) {
        if (t + 1.01 * h >= end) h = end - t, last = 1;
        double norm = step(rates, y, k, h, tol, y1, k1, e);
        r.evaluations += stages;
        if (norm <= 1.0) {
            if (!fsal) rates(y1, k1), r.evaluations++;
            t = last ? end : t + h;
            EACH y[i] = y1[i], k[i] = k1[i];
            note(++r.accepted, t, h, y, k, norm, e);
            double factor = 0.9 * pow(norm, -alpha);
            if (beta > 0.0) factor *= pow(before, beta);
            factor = clipped(factor, 0.2, after_rejection ? 1.0 : 10.0);
            before = larger(norm, 1e-4);
            after_rejection = 0;
            h *= factor;
        } else {
            trial[0][r.rejected] = t;
            trial[1][r.rejected] = h;
            trial[2][r.rejected++] = norm;
            h *= norm < INFINITY ? clipped(0.9 * pow(norm, -alpha), 0.2, 1.0) : 0.2;
            after_rejection = 1;
            last = 0;
        }
        if (r.accepted + 1 >= ROWS || r.rejected >= ROWS || !(h > 0.0)) break;
    }
    EACH r.y[i] = y[i];
    return r;
}

#define MARCHES(problem)                                                                                \
    static Result problem##_dormand_prince(const double *y, double end, double tol) {                  \
        return march(problem, dormand_prince, 6, 5.0, 0.04, 1, y, end, tol);                           \
    }                                                                                                   \
    static Result problem##_dop853(const double *y, double end, double tol) {                          \
        return march(problem, dop853, 11, 8.0, 0.0, 0, y, end, tol);                                   \
    }

MARCHES(arenstorf)
MARCHES(kepler)
MARCHES(double_pendulum)

static const struct {
    const char *name;
    Result (*dormand_prince)(const double *, double, double), (*dop853)(const double *, double, double);
    double start[M], end;
} PROBLEMS[] = {
    {"arenstorf", arenstorf_dormand_prince, arenstorf_dop853,
     {0.994, 0.0, 0.0, -2.00158510637908252240537862224}, 17.0652165601579625588917206249},
    {"kepler", kepler_dormand_prince, kepler_dop853, {0.1, 0.0, 0.0, 4.35889894354067355223698198386}, 20.0},
    {"double_pendulum", double_pendulum_dormand_prince, double_pendulum_dop853,
     {1.57079632679489661923132169164, 1.57079632679489661923132169164, 0.0, 0.0}, 10.0},
};

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* The blocks of the log; what was there is given back. */
static void allocate(void) {
    for (int i = 0; i < COLUMNS; i++) free(column[i]), column[i] = malloc(ROWS * sizeof(double));
    for (int i = 0; i < 3; i++) free(trial[i]), trial[i] = malloc(ROWS * sizeof(double));
}

int main(int count, char **words) {
    mass = given_mass;
    if (count != 4 && count != 5) return 2;
    int p = 0;
    while (p < 3 && strcmp(words[1], PROBLEMS[p].name)) p++;
    if (p == 3) return 2;
    int eighth = !strcmp(words[2], "dop853");
    if (!eighth && strcmp(words[2], "dormand_prince")) return 2;
    double tol = atof(words[3]), end = count == 5 ? atof(words[4]) : PROBLEMS[p].end;
    Result (*run)(const double *, double, double) = eighth ? PROBLEMS[p].dop853 : PROBLEMS[p].dormand_prince;
    allocate();
    static double spent[MOST_REPEATS];
    Result r = run(PROBLEMS[p].start, end, tol);
    int repeats = 0;
    for (double begin = seconds(); repeats < MOST_REPEATS && (repeats < 5 || seconds() - begin < 1.0); repeats++) {
        double now = seconds();
        if (count > 4) allocate(); /* a long log is new memory each time, as in a program that runs once */
        r = run(PROBLEMS[p].start, end, tol);
        spent[repeats] = seconds() - now;
    }
    qsort(spent, repeats, sizeof(double), ascending);
    printf("%.9f %.9f %ld %ld %ld", spent[0], spent[repeats / 2], r.accepted, r.rejected, r.evaluations);
    for (int i = 0; i < M; i++) printf(" %.17g", r.y[i]);
    printf("\n");
    return 0;
}
