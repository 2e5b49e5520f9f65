/* Vectors, turns, sums of rows, cosine transforms, splines, and non-negative least squares; C99, no allocation. */
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

/* The minimum of x A x - 2 x b with no x below 0, of three unknowns, one after the other (Gauss and Seidel). */
static void not_negative(double A[3][3], const double *b, double *x) {
  x[0] = x[1] = x[2] = 0.0;
  for (int i = 0; i < 3000; i++) x[i % 3] = fmax(x[i % 3] + (b[i % 3] - dot(A[i % 3], x)) / A[i % 3][i % 3], 0.0);
}

/* Weights of the values at n places of an axis for a cubic spline at x, beyond the ends for the end. The spline's slopes
   are S times the values. */
static void spline_weights(const float *axis, int n, const float *S, double x, double *w) {
  int i = 0;
  for (int j = 0; j < n; j++) w[j] = n == 1;
  if (n == 1) return;
  while (i < n - 2 && x >= axis[i + 1]) i++;
  double h = axis[i + 1] - axis[i], t = clip((x - axis[i]) / h, 0.0, 1.0), rest = 1.0 - t;
  for (int j = 0; j < n; j++) w[j] = h * t * rest * (rest * S[i * n + j] - t * S[(i + 1) * n + j]);
  w[i] += (1.0 + 2.0 * t) * rest * rest;
  w[i + 1] += t * t * (3.0 - 2.0 * t);
}

#endif
