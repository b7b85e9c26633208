/* How fast the machine is: the filters as plain C loops over SIMD lanes.

   Many runs stand side by side on the last axis; a vector V holds LANES of them. All
   small matrices are written out (the loops below have constant lengths and unroll), a
   symmetric matrix is its upper triangle, and the state of LANES runs stays in registers
   or the first cache for all scans. Compiled once with REAL=float, once with double; the
   number of runs is a multiple of LANES. The motions are dense: no zero is known.

   It is a practical limit, not a proof of one. */
#include <math.h>
#include <string.h>

#ifdef SINGLE
typedef float REAL;
typedef int WHOLE;
#define OF(name) name##f
#else
typedef double REAL;
typedef long WHOLE;
#define OF(name) name
#endif

enum { LANES = 64 / sizeof(REAL), Z = 2, MODES = 5 };
typedef REAL V __attribute__((vector_size(64)));
typedef WHOLE MASK __attribute__((vector_size(64)));

#define INLINE static inline __attribute__((always_inline))
#define EACH(i, from, to) _Pragma("GCC unroll 16") for (int i = from; i < to; i++)

INLINE V load(const REAL *from) { V v; memcpy(&v, from, sizeof v); return v; }
INLINE void store(REAL *to, V v) { memcpy(to, &v, sizeof v); }
INLINE V all(REAL x) { return x - (V){0}; }
INLINE V choose(MASK yes, V a, V b) { return (V)((yes & (MASK)a) | (~yes & (MASK)b)); }

/* The compiler turns these loops into calls of the vector mathematics library. */
#define LANEWISE(name, function) \
  INLINE V name(V v) { \
    REAL x[LANES] __attribute__((aligned(64))); \
    memcpy(x, &v, sizeof v); \
    for (int i = 0; i < LANES; i++) x[i] = OF(function)(x[i]); \
    memcpy(&v, x, sizeof v); \
    return v; \
  }
LANEWISE(log_of, log)
LANEWISE(exp_of, exp)
LANEWISE(sin_of, sin)
LANEWISE(cos_of, cos)
LANEWISE(sqrt_of, sqrt)
LANEWISE(round_of, rint)

/* An odd polynomial on [0, 1], right to about 1e-7. */
INLINE V angle_of(V y, V x) {
  static const REAL c[] = {0.0028662257,  -0.0161657367, 0.0429096138, -0.0752896400,
                           0.1065626393,  -0.1420889944, 0.1999355085, -0.3333314528};
  V ax = choose(x < 0, -x, x), ay = choose(y < 0, -y, y);
  V a = choose(ay > ax, ax, ay) / choose(ay > ax, ay, ax), s = a * a, r = all(c[0]);
  EACH(k, 1, 8) r = r * s + c[k];
  r = a + a * s * r;
  r = choose(ay > ax, (REAL)1.5707963267948966 - r, r);
  r = choose(x < 0, (REAL)3.141592653589793 - r, r);
  return choose(y < 0, -r, r);
}

/* Where entry (i, j) of a symmetric matrix of n rows stands in its upper triangle. */
INLINE int at(int n, int i, int j) {
  return i <= j ? i * n - i * (i - 1) / 2 + j - i : j * n - j * (j - 1) / 2 + i - j;
}

INLINE V dot(int n, const REAL *row, const V *x, int stride) {
  V sum = row[0] * x[0];
  EACH(k, 1, n) sum += row[k] * x[k * stride];
  return sum;
}

/* x <- F x, P <- F P F' + Q */
INLINE void predict(int n, const REAL *F, const REAL *Q, V *x, V *P) {
  V moved[n], A[n * n];
  EACH(i, 0, n) moved[i] = dot(n, F + i * n, x, 1);
  EACH(i, 0, n) x[i] = moved[i];
  EACH(i, 0, n) EACH(j, 0, n) {
    V sum = F[i * n] * P[at(n, 0, j)];
    EACH(k, 1, n) sum += F[i * n + k] * P[at(n, k, j)];
    A[i * n + j] = sum;
  }
  EACH(i, 0, n) EACH(j, i, n)
    P[at(n, i, j)] = dot(n, F + j * n, A + i * n, 1) + Q[i * n + j];
}

/* Conditions on a residual, given H P and the triangle of H P H' + R. Returns the
   log-density. */
INLINE V correct(int n, V *x, V *P, const V *HP, const V *S, V v0, V v1) {
  V det = S[0] * S[2] - S[1] * S[1], one = 1 / det;
  V a = S[2] * one, b = -S[1] * one, c = S[0] * one;
  V w0 = a * v0 + b * v1, w1 = b * v0 + c * v1, K0[n], K1[n];
  EACH(i, 0, n) {
    K0[i] = HP[i] * a + HP[n + i] * b;
    K1[i] = HP[i] * b + HP[n + i] * c;
    x[i] += HP[i] * w0 + HP[n + i] * w1;
  }
  EACH(i, 0, n) EACH(j, i, n) P[at(n, i, j)] -= K0[i] * HP[j] + K1[i] * HP[n + j];
  return (REAL)-0.5 * (v0 * w0 + v1 * w1 + log_of(det)) - (REAL)1.8378770664093453;
}

/* H P, and the triangle of H P H' + R */
INLINE void observe(int n, const REAL *H, const REAL *R, const V *P, V *HP, V *S) {
  EACH(i, 0, Z) EACH(j, 0, n) {
    V sum = H[i * n] * P[at(n, 0, j)];
    EACH(k, 1, n) sum += H[i * n + k] * P[at(n, k, j)];
    HP[i * n + j] = sum;
  }
  S[0] = dot(n, H, HP, 1) + R[0];
  S[1] = dot(n, H + n, HP, 1) + R[1];
  S[2] = dot(n, H + n, HP + n, 1) + R[3];
}

INLINE V update(int n, const REAL *H, const REAL *R, V *x, V *P, V z0, V z1) {
  V HP[Z * n], S[3];
  observe(n, H, R, P, HP, S);
  return correct(n, x, P, HP, S, z0 - dot(n, H, x, 1), z1 - dot(n, H + n, x, 1));
}

/* Arrays are [n, runs] and [n * n, runs]. */
INLINE void begin(int n, long runs, long run, const REAL *mean, const REAL *cov, V *x, V *P) {
  EACH(i, 0, n) x[i] = load(mean + i * runs + run);
  EACH(i, 0, n) EACH(j, i, n) P[at(n, i, j)] = load(cov + (i * n + j) * runs + run);
}

INLINE void finish(int n, long runs, long run, REAL *mean, REAL *cov, const V *x, const V *P) {
  EACH(i, 0, n) store(mean + i * runs + run, x[i]);
  EACH(i, 0, n) EACH(j, 0, n) store(cov + (i * n + j) * runs + run, P[at(n, i, j)]);
}

/* Kalman filter, 4 states, 2 outputs: detections [scans, 2, runs]. With keep, all
   filtered beliefs are stored, [scans, 4, runs] and [scans, 16, runs], else the last. */
void kalman(long runs, long scans, const REAL *F, const REAL *Q, const REAL *H,
            const REAL *R, const REAL *mean, const REAL *cov, const REAL *detections,
            REAL *out_mean, REAL *out_cov, REAL *log_density, long keep) {
  for (long run = 0; run < runs; run += LANES) {
    V x[4], P[10], sum = {0};
    begin(4, runs, run, mean, cov, x, P);
    for (long t = 0; t < scans; t++) {
      const REAL *z = detections + t * Z * runs + run;
      predict(4, F, Q, x, P);
      sum += update(4, H, R, x, P, load(z), load(z + runs));
      if (keep) finish(4, runs, run, out_mean + t * 4 * runs, out_cov + t * 16 * runs, x, P);
    }
    if (!keep) finish(4, runs, run, out_mean, out_cov, x, P);
    store(log_density + run, sum);
  }
}

/* The moments of MODES Gaussians under weights. */
INLINE void collapse(const V *weight, V x[MODES][4], V P[MODES][10], V *mean, V *cov) {
  EACH(a, 0, 4) {
    mean[a] = weight[0] * x[0][a];
    EACH(i, 1, MODES) mean[a] += weight[i] * x[i][a];
  }
  EACH(e, 0, 10) cov[e] = all(0);
  EACH(i, 0, MODES) {
    V gap[4];
    EACH(a, 0, 4) gap[a] = x[i][a] - mean[a];
    EACH(a, 0, 4) EACH(b, a, 4)
      cov[at(4, a, b)] += weight[i] * (P[i][at(4, a, b)] + gap[a] * gap[b]);
  }
}

/* Interacting multiple models: F and Q are [MODES, 16], switching is [MODES, MODES]. All
   modes begin alike. Stored is the belief over all modes after the last scan. */
void imm(long runs, long scans, const REAL *F, const REAL *Q, const REAL *H, const REAL *R,
         const REAL *switching, const REAL *mean, const REAL *cov, const REAL *detections,
         REAL *out_mean, REAL *out_cov, REAL *out_prob, REAL *log_density) {
  for (long run = 0; run < runs; run += LANES) {
    V x[MODES][4], P[MODES][10], prob[MODES], total = {0};
    EACH(m, 0, MODES) {
      prob[m] = all((REAL)1 / MODES);
      begin(4, runs, run, mean, cov, x[m], P[m]);
    }
    for (long t = 0; t < scans; t++) {
      V entered[MODES], mixed[MODES][4], mixed_cov[MODES][10], density[MODES];
      const REAL *z = detections + t * Z * runs + run;
      for (int j = 0; j < MODES; j++) {
        V weight[MODES];
        entered[j] = all(0);
        EACH(i, 0, MODES) entered[j] += prob[i] * switching[i * MODES + j];
        V one = 1 / entered[j];
        EACH(i, 0, MODES) weight[i] = prob[i] * switching[i * MODES + j] * one;
        collapse(weight, x, P, mixed[j], mixed_cov[j]);
      }
      memcpy(x, mixed, sizeof x);
      memcpy(P, mixed_cov, sizeof P);
      for (int m = 0; m < MODES; m++) {
        predict(4, F + m * 16, Q + m * 16, x[m], P[m]);
        density[m] = update(4, H, R, x[m], P[m], load(z), load(z + runs));
      }
      V top = density[0], sum = {0};
      EACH(m, 1, MODES) top = choose(density[m] > top, density[m], top);
      EACH(m, 0, MODES) {
        prob[m] = entered[m] * exp_of(density[m] - top);
        sum += prob[m];
      }
      V one = 1 / sum;
      EACH(m, 0, MODES) prob[m] *= one;
      total += top + log_of(sum);
    }
    V whole[4], whole_cov[10];
    collapse(prob, x, P, whole, whole_cov);
    finish(4, runs, run, out_mean, out_cov, whole, whole_cov);
    EACH(m, 0, MODES) store(out_prob + m * runs + run, prob[m]);
    store(log_density + run, total);
  }
}

/* Extended Kalman filter: a turn at an unknown rate, state [x, vx, y, vy, rate], seen in
   range and bearing from the origin. Jacobians by hand, their zeros used. */
void extended(long runs, long scans, REAL dt, const REAL *Q, const REAL *R, const REAL *mean,
              const REAL *cov, const REAL *detections, REAL *out_mean, REAL *out_cov,
              REAL *log_density) {
  enum { N = 5 };
  for (long run = 0; run < runs; run += LANES) {
    V x[N], P[15], A[N][N], total = {0};
    begin(N, runs, run, mean, cov, x, P);
    for (long t = 0; t < scans; t++) {
      V rate = x[4], size = choose(rate < 0, -rate, rate);
      rate = choose(size < (REAL)1e-4, all((REAL)1e-4), rate);
      V s = sin_of(rate * dt), c = cos_of(rate * dt), one = 1 / rate;
      V a = s * one, g = (1 - c) * one, da = (c * dt - a) * one, dg = (s * dt - g) * one;
      V vx = x[1], vy = x[3];
      V d0 = da * vx - dg * vy, d1 = -dt * (s * vx + c * vy);
      V d2 = dg * vx + da * vy, d3 = dt * (c * vx - s * vy);
      x[0] += a * vx - g * vy, x[1] = c * vx - s * vy;
      x[2] += g * vx + a * vy, x[3] = s * vx + c * vy;
      EACH(j, 0, N) {
        V p0 = P[at(N, 0, j)], p1 = P[at(N, 1, j)], p2 = P[at(N, 2, j)];
        V p3 = P[at(N, 3, j)], p4 = P[at(N, 4, j)];
        A[0][j] = p0 + a * p1 - g * p3 + d0 * p4, A[1][j] = c * p1 - s * p3 + d1 * p4;
        A[2][j] = p2 + g * p1 + a * p3 + d2 * p4, A[3][j] = s * p1 + c * p3 + d3 * p4;
        A[4][j] = p4;
      }
      EACH(i, 0, N) {
        V *row = A[i], e = row[4];
        V full[N] = {row[0] + a * row[1] - g * row[3] + d0 * e, c * row[1] - s * row[3] + d1 * e,
                     row[2] + g * row[1] + a * row[3] + d2 * e, s * row[1] + c * row[3] + d3 * e, e};
        EACH(j, i, N) P[at(N, i, j)] = full[j] + Q[i * N + j];
      }
      V r = sqrt_of(x[0] * x[0] + x[2] * x[2]), over = 1 / r, HP[Z * N], S[3];
      V hx = x[0] * over, hy = x[2] * over, bx = -hy * over, by = hx * over;
      const REAL *z = detections + t * Z * runs + run;
      V v1 = load(z + runs) - angle_of(x[2], x[0]);
      v1 -= (REAL)6.283185307179586 * round_of(v1 * (REAL)0.15915494309189535);
      EACH(j, 0, N) HP[j] = hx * P[at(N, 0, j)] + hy * P[at(N, 2, j)];
      EACH(j, 0, N) HP[N + j] = bx * P[at(N, 0, j)] + by * P[at(N, 2, j)];
      S[0] = HP[0] * hx + HP[2] * hy + R[0];
      S[1] = HP[0] * bx + HP[2] * by + R[1];
      S[2] = HP[N] * bx + HP[N + 2] * by + R[3];
      total += correct(N, x, P, HP, S, load(z) - r, v1);
    }
    finish(N, runs, run, out_mean, out_cov, x, P);
    store(log_density + run, total);
  }
}

/* Every component with every detection [num, 2]: log-densities [num, size], means
   [num, 4, size], and the covariances [16, size], which no detection changes. */
void gaussians(long size, long num, const REAL *H, const REAL *R, const REAL *mean,
               const REAL *cov, const REAL *detections, REAL *log_density, REAL *out_mean,
               REAL *out_cov) {
  for (long n = 0; n < size; n += LANES) {
    V x[4], P[10], HP[Z * 4], S[3], K0[4], K1[4];
    begin(4, size, n, mean, cov, x, P);
    observe(4, H, R, P, HP, S);
    V z0 = dot(4, H, x, 1), z1 = dot(4, H + 4, x, 1);
    V det = S[0] * S[2] - S[1] * S[1], one = 1 / det;
    V a = S[2] * one, b = -S[1] * one, c = S[0] * one;
    V scale = (REAL)-0.5 * log_of(det) - (REAL)1.8378770664093453;
    EACH(i, 0, 4) K0[i] = HP[i] * a + HP[4 + i] * b, K1[i] = HP[i] * b + HP[4 + i] * c;
    EACH(i, 0, 4) EACH(j, i, 4) P[at(4, i, j)] -= K0[i] * HP[j] + K1[i] * HP[4 + j];
    EACH(i, 0, 4) EACH(j, 0, 4) store(out_cov + (i * 4 + j) * size + n, P[at(4, i, j)]);
    for (long k = 0; k < num; k++) {
      V v0 = detections[2 * k] - z0, v1 = detections[2 * k + 1] - z1;
      V off = a * v0 * v0 + 2 * b * v0 * v1 + c * v1 * v1;
      store(log_density + k * size + n, scale - (REAL)0.5 * off);
      EACH(i, 0, 4) store(out_mean + (k * 4 + i) * size + n, x[i] + K0[i] * v0 + K1[i] * v1);
    }
  }
}
