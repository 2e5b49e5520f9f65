/* Vectors, turns, sums of rows, cosine transforms, splines, and a small quadratic programme; C99, no allocation. */
#ifndef MATHS_H
#define MATHS_H
#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846
#define HALF 512
#define GRID (HALF + 1)
#define WIDE 8

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static double clip(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

static void cross(const double *a, const double *b, double *out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

static void unit(double *v) {
  double s = sqrt(dot(v, v));
  for (int i = 0; i < 3; i++) v[i] /= s;
}

/* Matrices of three rows are handed over as nine numbers. */
static void times(const double *M, const double *v, double *out) {
  for (int i = 0; i < 3; i++) out[i] = dot(M + 3 * i, v);
}

static void times_transposed(const double *M, const double *v, double *out) {
  for (int i = 0; i < 3; i++) out[i] = M[i] * v[0] + M[3 + i] * v[1] + M[6 + i] * v[2];
}

/* Two unit vectors across a third. */
static void basis(const double *axis, double *a, double *b) {
  double helper[3] = {0, 0, 0};
  int least = 0;
  for (int i = 1; i < 3; i++)
    if (fabs(axis[i]) < fabs(axis[least])) least = i;
  helper[least] = 1.0;
  cross(helper, axis, a);
  unit(a);
  cross(axis, a, b);
}

/* R <- exp(w) R */
static void turn(double R[3][3], const double *w) {
  double angle = sqrt(dot(w, w)), new_[3][3];
  if (angle == 0.0) return;
  double k[3] = {w[0] / angle, w[1] / angle, w[2] / angle}, c = cos(angle), s = sin(angle);
  for (int j = 0; j < 3; j++) {
    double v[3] = {R[0][j], R[1][j], R[2][j]}, kv[3], along = (1.0 - c) * dot(k, v);
    cross(k, v, kv);
    for (int i = 0; i < 3; i++) new_[i][j] = c * v[i] + s * kv[i] + along * k[i];
  }
  memcpy(R, new_, sizeof new_);
}

/* The rotation vector of A B^T, small enough to be told by its antisymmetric part and angle. */
static void turn_between(const double *A, const double *B, double *w) {
  double M[3][3];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) M[i][j] = dot(A + 3 * i, B + 3 * j);
  double v[3] = {M[2][1] - M[1][2], M[0][2] - M[2][0], M[1][0] - M[0][1]};
  double s = 0.5 * sqrt(dot(v, v)), c = 0.5 * (M[0][0] + M[1][1] + M[2][2] - 1.0), angle = atan2(s, c);
  double factor = s > 1e-12 ? 0.5 * angle / s : 0.5;
  for (int i = 0; i < 3; i++) w[i] = factor * v[i];
}

static void from_quaternion(const double *q, double R[3][3]) {
  double x = q[0], y = q[1], z = q[2], w = q[3];
  double M[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
                    {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
                    {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
  memcpy(R, M, sizeof M);
}

static void to_quaternion(double R[3][3], double *q) {
  double squares[4] = {1 + R[0][0] - R[1][1] - R[2][2], 1 - R[0][0] + R[1][1] - R[2][2], 1 - R[0][0] - R[1][1] + R[2][2],
                       1 + R[0][0] + R[1][1] + R[2][2]};
  int k = 0;
  for (int i = 1; i < 4; i++)
    if (squares[i] > squares[k]) k = i;
  double twice[4][4] = {{squares[0], R[1][0] + R[0][1], R[2][0] + R[0][2], R[2][1] - R[1][2]},
                        {R[1][0] + R[0][1], squares[1], R[2][1] + R[1][2], R[0][2] - R[2][0]},
                        {R[2][0] + R[0][2], R[2][1] + R[1][2], squares[2], R[1][0] - R[0][1]},
                        {R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1], squares[3]}};
  for (int i = 0; i < 4; i++) q[i] = 0.5 * twice[k][i] / sqrt(squares[k]);
}

/* The median by halves, as Hoare finds it; changes the order. */
static double median(double *x, int n) {
  double found[2];
  for (int which = 0; which < 2; which++) {
    int k = which ? n / 2 : (n - 1) / 2;
    for (int low = 0, high = n - 1; low < high;) {
      double middle = x[k];
      int i = low, j = high;
      while (i <= j) {
        while (x[i] < middle) i++;
        while (x[j] > middle) j--;
        if (i > j) break;
        double t = x[i];
        x[i++] = x[j], x[j--] = t;
      }
      if (j < k) low = i;
      if (k < i) high = j;
    }
    found[which] = x[k];
  }
  return 0.5 * (found[0] + found[1]);
}

static double largest_of(const double *x, int stride, int n) {
  double largest = x[0];
  for (int i = 1; i < n; i++) largest = x[i * stride] > largest ? x[i * stride] : largest;
  return largest;
}

/* Share of a normal number's values that are below z. */
static double normal(double z) { return 0.5 * erfc(-z / sqrt(2.0)); }

/* Sum of products. */
static double product(const double *a, const double *b, int n) {
  double s[4] = {0, 0, 0, 0};
  int i = 0;
  for (; i + 3 < n; i += 4)
    for (int j = 0; j < 4; j++) s[j] += a[i + j] * b[i + j];
  for (; i < n; i++) s[0] += a[i] * b[i];
  return s[0] + s[1] + s[2] + s[3];
}

/* Adds multiples of four rows to another. Up to WIDE - 1 numbers beyond n are changed too, so that a compiler has whole
   vectors. */
static void add_rows(double *restrict out, const double *share, const double *restrict row, int stride, int n) {
  const double a = share[0], b = share[1], c = share[2], d = share[3];
  const double *restrict second = row + stride, *restrict third = second + stride, *restrict fourth = third + stride;
  for (int i = 0; i < n; i += WIDE)
    for (int j = i; j < i + WIDE; j++) out[j] += a * row[j] + b * second[j] + c * third[j] + d * fourth[j];
}

/* Fourier transform of a power of 2 of complex numbers. */
static void fft(double *re, double *im, int size) {
  static double cosine[HALF], sine[HALF];
  if (cosine[0] == 0.0)
    for (int i = 0; i < HALF; i++) cosine[i] = cos(PI * i / HALF), sine[i] = -sin(PI * i / HALF);
  for (int i = 1, j = 0; i < size; i++) {
    int bit = size / 2;
    for (; j & bit; bit /= 2) j ^= bit;
    j ^= bit;
    if (i < j) {
      double t = re[i];
      re[i] = re[j], re[j] = t;
      t = im[i], im[i] = im[j], im[j] = t;
    }
  }
  for (int part = 2; part <= size; part *= 2)
    for (int first = 0; first < size; first += part)
      for (int k = 0; k < part / 2; k++) {
        int a = first + k, b = a + part / 2, w = k * (2 * HALF / part);
        double x = re[b] * cosine[w] - im[b] * sine[w], y = re[b] * sine[w] + im[b] * cosine[w];
        re[b] = re[a] - x, im[b] = im[a] - y;
        re[a] += x, im[a] += y;
      }
}

/* Cosine transform of two even sequences of half + 1 numbers at once: their mirror images complete them. */
static void cosines(double *a, double *b, int half, double scale) {
  static double re[2 * HALF], im[2 * HALF];
  for (int i = 0; i <= half; i++) {
    int mirror = (2 * half - i) % (2 * half);
    re[i] = re[mirror] = a[i];
    im[i] = im[mirror] = b[i];
  }
  fft(re, im, 2 * half);
  for (int i = 0; i <= half; i++) a[i] = scale * re[i], b[i] = scale * im[i];
}

static double sinc(double x) { return fabs(x) < 1e-8 ? 1.0 : sin(PI * x) / (PI * x); }

/* The minimum of x A x - 2 x b with no x below 0, of three unknowns: the best of all choices of those above 0. */
static void not_negative(double A[3][3], const double *b, double *x) {
  double best = 0.0;
  x[0] = x[1] = x[2] = 0.0;
  for (int chosen = 1; chosen < 8; chosen++) {
    double M[3][4], y[3] = {0, 0, 0}, value = 0.0;
    int ok = 1;
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 4; j++) {
        int in = chosen >> i & 1 && (j == 3 || chosen >> j & 1);
        M[i][j] = in ? (j < 3 ? A[i][j] : b[i]) : i == j ? 1.0 : 0.0;
      }
    for (int k = 0; k < 3; k++)
      for (int i = k + 1; i < 3; i++)
        for (int j = 3; j >= k; j--) M[i][j] -= M[i][k] / M[k][k] * M[k][j];
    for (int i = 2; i >= 0; i--) {
      y[i] = M[i][3];
      for (int j = i + 1; j < 3; j++) y[i] -= M[i][j] * y[j];
      y[i] /= M[i][i];
      ok = ok && y[i] >= 0.0;
    }
    for (int i = 0; i < 3; i++) value -= y[i] * b[i];
    if (ok && value < best) best = value, memcpy(x, y, sizeof y);
  }
}

/* A cubic spline through places of an axis. Its slopes are S times the values there, so that its second derivative is
   steady; at the ends 0 where they are level, else those of the parabola through three places. next_share: room for n. */
static void spline_slopes(const float *axis, int n, int level_first, int level_last, double *S, double *next_share) {
  memset(S, 0, (size_t)n * n * sizeof *S);
  if (n == 1) return;
  for (int i = 0; i < n; i++) {
    double *row = S + i * n, low = 0.0, diagonal = 1.0, above = 0.0;
    if (i > 0 && i < n - 1) {
      double before = axis[i] - axis[i - 1], after = axis[i + 1] - axis[i];
      low = after, diagonal = 2.0 * (before + after), above = before;
      row[i - 1] = -3.0 * after / before, row[i + 1] = 3.0 * before / after;
      row[i] = -row[i - 1] - row[i + 1];
    } else if (i == 0 ? !level_first : !level_last) {
      int a = i == 0 ? 0 : n - 1, b = i == 0 ? 1 : n - 2, c = i == 0 ? 2 : n - 3;
      double near = axis[b] - axis[a], far = n > 2 ? axis[c] - axis[b] : 0.0, bend = n > 2 ? near / (near + far) : 0.0;
      row[b] = (1.0 + bend) / near, row[a] = -row[b];
      if (n > 2) row[b] += bend / far, row[c] = -bend / far;
    }
    if (i > 0) {
      diagonal -= low * next_share[i - 1];
      for (int j = 0; j < n; j++) row[j] -= low * row[j - n];
    }
    for (int j = 0; j < n; j++) row[j] /= diagonal;
    next_share[i] = above / diagonal;
  }
  for (int i = n - 2; i >= 0; i--)
    for (int j = 0; j < n; j++) S[i * n + j] -= next_share[i] * S[(i + 1) * n + j];
}

/* What the values at the places of an axis count for at x; its ends hold. */
static void spline_weights(const float *axis, int n, const double *S, double x, double *w) {
  int i = 0;
  memset(w, 0, n * sizeof *w);
  w[0] = 1.0;
  if (n == 1) return;
  while (i < n - 2 && x >= axis[i + 1]) i++;
  double h = axis[i + 1] - axis[i], t = clip((x - axis[i]) / h, 0.0, 1.0), rest = 1.0 - t;
  for (int j = 0; j < n; j++) w[j] = h * t * rest * (rest * S[i * n + j] - t * S[(i + 1) * n + j]);
  w[i] += (1.0 + 2.0 * t) * rest * rest;
  w[i + 1] += t * t * (3.0 - 2.0 * t);
}

#endif
