/* The tilt of a camera from one image of the limb, by rendered profiles: a reference for a flight computer. C99, one
   file, no allocation, no library but libm. It reads table.h of `horizonval templates`.

   A pixel whose line of sight passes at the height h over the ellipsoid, between two nodes along the limb, is

       I = background + gain * light * P_s(h - lift) + noise,      P = mean + sum over modes of a_k mode_k

   with the table's profiles at the nodes, blurred by a Gaussian of s pixels, linear between nodes, and light the cosine
   of the off-axis angle to the fourth. Unknown: turn (3), position (3), lift, the logarithms of blur and gain,
   background, and the coefficients a_k at every node. Priors are rows of the same normal equations:

       step = (J^T W J + Q)^-1 (J^T W residuals + Q (prior - now)),        C = (J^T W J + Q)^-1

   Coefficients of one mode at two nodes an angle d apart at the Earth's centre have the correlation exp(-d^2 / 2 l^2).

   Left out: lenses with distortion, what the modes leave over, pixels whose noise is not independent.

   Standard input: one line of 22 numbers, and then width * height values of 16 bits in the machine's order, row by row:
     width height fx fy cx cy                  pixels
     rx ry rz  sigma_position                  m, Earth-fixed axes
     qx qy qz qw  sigma_attitude               from Earth-fixed to camera axes; rad, about any axis
     month                                     1.0 in the middle of January
     sx sy sz                                  towards the Sun, camera axes
     blur  blur_log_sigma  lift_sigma          px of the lens, m
   Standard output: one JSON object, as docs/howto/estimator-program.md says. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "table.h"

#define MOST_PIXELS (2048 * 2048)
#define MOST_NEAR 400000
#define MOST_NODES 24
#define SHARED 10
#define MOST_UNKNOWNS (SHARED + MOST_NODES * LIMB_K)
#define FUNCTIONS (LIMB_K + 1)
#define GRID 1200
#define PI 3.14159265358979323846

static const double A_M = 6378137.0;
static const double NODE_RAD = 0.035, OUTLIER = 5.0, PIXEL_VARIANCE = 1.0 / 12.0;
static const double DEPTH_M = 40e3, DEPTH_PX = 4.0, SPACE_PX = 4.0, SETTLED_PX = 0.01;

static uint16_t image[MOST_PIXELS];
static int width, height;
static double fx, fy, cx, cy, sigma_r, sigma_q, month, sun[3], blur_prior, blur_sigma, lift_sigma;

typedef struct {
  double R[3][3], r[3], lift, blur, gain, background, a[MOST_NODES][LIMB_K + 1];
} State;
typedef struct {
  double value, weight, h, distance, width_m, light, share;
  double u[3], n[3];
  int node;
} Pixel;

static Pixel near_[MOST_NEAR];
static int count, nodes;
static double node_azimuth[MOST_NODES], node_width[MOST_NODES], node_place[MOST_NODES][3];
static double axis_a[3], axis_b[3];
static double profiles[MOST_NODES][FUNCTIONS][LIMB_H];
static double grid_low, grid_step;
static double value_of[MOST_NODES][FUNCTIONS][GRID], slope_of[MOST_NODES][GRID], blur_of[MOST_NODES][GRID];
static double N[MOST_UNKNOWNS][MOST_UNKNOWNS], L[MOST_UNKNOWNS][MOST_UNKNOWNS], right_[MOST_UNKNOWNS];
static double prior_information[LIMB_K + 1][MOST_NODES][MOST_NODES];

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double *a, const double *b, double *out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

static void unit(double *v) {
  double s = sqrt(dot(v, v));
  for (int i = 0; i < 3; i++) v[i] /= s;
}

static void times(double M[3][3], const double *v, double *out) {
  for (int i = 0; i < 3; i++) out[i] = dot(M[i], v);
}

static void times_transposed(double M[3][3], const double *v, double *out) {
  for (int i = 0; i < 3; i++) out[i] = M[0][i] * v[0] + M[1][i] * v[1] + M[2][i] * v[2];
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
static void turn_between(double A[3][3], double B[3][3], double *w) {
  double M[3][3];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) M[i][j] = dot(A[i], B[j]);
  double v[3] = {M[2][1] - M[1][2], M[0][2] - M[2][0], M[1][0] - M[0][1]};
  double s = 0.5 * sqrt(dot(v, v)), c = 0.5 * (M[0][0] + M[1][1] + M[2][2] - 1.0), angle = atan2(s, c);
  double factor = s > 1e-12 ? 0.5 * angle / s : 0.5;
  for (int i = 0; i < 3; i++) w[i] = factor * v[i];
}

/* Line of sight of a pixel, and how it changes by column and row. */
static void sight(double column, double row, double *u, double *by_column, double *by_row) {
  double v[3] = {(column - cx) / fx, (row - cy) / fy, 1.0}, s = 1.0 / sqrt(dot(v, v));
  double e[2][3] = {{1.0 / fx, 0.0, 0.0}, {0.0, 1.0 / fy, 0.0}}, *by[2];
  by[0] = by_column;
  by[1] = by_row;
  for (int i = 0; i < 3; i++) u[i] = v[i] * s;
  for (int k = 0; k < 2; k++)
    for (int i = 0; i < 3; i++) by[k][i] = s * (e[k][i] - u[i] * dot(u, e[k]));
}

/* Height of the lowest point, distance to it, and the normal there in camera axes; 0 if the point lies behind. */
static int lowest(const State *s, const double *u, double *h, double *distance, double *n_cam) {
  static const double axes[3] = {6378137.0, 6378137.0, 6356752.314245};
  double d[3], p[3], e[3], q[3], g[3];
  times_transposed((double(*)[3])s->R, u, d);
  for (int i = 0; i < 3; i++) p[i] = s->r[i] / axes[i], e[i] = d[i] / axes[i];
  *distance = -dot(p, e) / dot(e, e);
  for (int i = 0; i < 3; i++) q[i] = p[i] + *distance * e[i];
  double m = sqrt(dot(q, q));
  for (int i = 0; i < 3; i++) g[i] = q[i] / m / axes[i];
  double size = sqrt(dot(g, g));
  *h = (m - 1.0) / size;
  for (int i = 0; i < 3; i++) g[i] /= size;
  times((double(*)[3])s->R, g, n_cam);
  return *distance > 0.0;
}

static void nadir_of(const State *s, double *nadir) {
  double down[3] = {-s->r[0], -s->r[1], -s->r[2]};
  unit(down);
  times((double(*)[3])s->R, down, nadir);
}

static int before(const float *axis, int n, double x, double *share) {
  int i = 0;
  while (i < n - 2 && x >= axis[i + 1]) i++;
  *share = n == 1 ? 0.0 : fmin(fmax((x - axis[i]) / (axis[i + 1] - axis[i]), 0.0), 1.0);
  return i;
}

/* The table's profiles at a place: mean and modes on its heights. */
static void at_place(double first, double second, double out[FUNCTIONS][LIMB_H]) {
  double u, v;
  int i = before(limb_first, LIMB_A, first, &u), j, next;
  if (LIMB_THERMAL) {
    double x = limb_second[0] + fmod(fmod(second - limb_second[0], 12.0) + 12.0, 12.0);
    for (j = 0; j < LIMB_B - 1 && x >= limb_second[j + 1];) j++;
    next = (j + 1) % LIMB_B;
    double end = j + 1 < LIMB_B ? limb_second[next] : limb_second[0] + 12.0;
    v = (x - limb_second[j]) / (end - limb_second[j]);
  } else {
    j = before(limb_second, LIMB_B, second, &v);
    next = j + 1 < LIMB_B ? j + 1 : j;
  }
  int below = i + 1 < LIMB_A ? i + 1 : i;
  int corner[4] = {i * LIMB_B + j, i * LIMB_B + next, below * LIMB_B + j, below * LIMB_B + next};
  double share[4] = {(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v};
  memset(out, 0, sizeof(double[FUNCTIONS][LIMB_H]));
  for (int c = 0; c < 4; c++)
    for (int h = 0; h < LIMB_H; h++) {
      out[0][h] += share[c] * limb_mean_scale[corner[c]] * limb_mean[corner[c] * LIMB_H + h];
      for (int k = 0; k < LIMB_K; k++) {
        int row = corner[c] * (LIMB_K + 1) + k;
        out[k + 1][h] += share[c] * limb_modes_scale[row] * limb_modes[row * LIMB_H + h];
      }
    }
}

static void at_direction(const State *s, const double *u, double out[FUNCTIONS][LIMB_H], double *place) {
  double h, distance, n[3], up[3];
  lowest(s, u, &h, &distance, n);
  times_transposed((double(*)[3])s->R, n, up);
  memcpy(place, up, sizeof up);
  if (LIMB_THERMAL) {
    at_place(asin(fmin(fmax(up[2], -1.0), 1.0)), month, out);
  } else {
    double side[3];
    cross(n, u, side);
    at_place(acos(fmin(fmax(dot(n, sun), -1.0), 1.0)), fabs(atan2(dot(side, sun), dot(u, sun))), out);
  }
}

/* Polygons over height, blurred: constant below, nothing above. With t = (x - z) / sigma every bend of slope D at z adds
   D sigma (t Phi + phi); the derivatives of that by x and by ln sigma are D Phi and D sigma phi. The first function's go
   to slope and by_log. */
static void blurred(const double (*bends)[LIMB_H + 1], const double *bottom, int functions, double sigma, double x,
                    double *value, double *slope, double *by_log) {
  for (int k = 0; k < functions; k++) value[k] = bottom[k];
  *slope = *by_log = 0.0;
  for (int j = 0; j < LIMB_H + 1; j++) {
    /* above the last height the light fades over a kilometre */
    double z = j < LIMB_H ? limb_height_m[j] : limb_height_m[LIMB_H - 1] + 1000.0, t = (x - z) / sigma;
    if (t < -8.0) break;
    double phi = exp(-0.5 * t * t) / sqrt(2.0 * PI), Phi = t > 8.0 ? 1.0 : 0.5 * erfc(-t / sqrt(2.0));
    for (int k = 0; k < functions; k++) value[k] += bends[k][j] * sigma * (t * Phi + phi);
    *slope += bends[0][j] * Phi;
    *by_log += bends[0][j] * sigma * phi;
  }
}

static void bends_of(const double *f, double *bends) {
  double old = 0.0;
  for (int j = 0; j < LIMB_H + 1; j++) {
    double new_ = j < LIMB_H - 1 ? (f[j + 1] - f[j]) / (limb_height_m[j + 1] - limb_height_m[j])
                : j == LIMB_H - 1 ? -f[j] / 1000.0
                                  : 0.0;
    bends[j] = new_ - old;
    old = new_;
  }
}

/* All functions of all nodes on the grid, for the present blur and coefficients. */
static void fill_grid(const State *s) {
  static double sum[LIMB_H], bends[FUNCTIONS][LIMB_H + 1];
  for (int m = 0; m < nodes; m++) {
    double sigma = s->blur * node_width[m], bottom[FUNCTIONS], value[FUNCTIONS];
    memcpy(sum, profiles[m][0], sizeof sum);
    for (int k = 0; k < LIMB_K; k++)
      for (int h = 0; h < LIMB_H; h++) sum[h] += s->a[m][k] * profiles[m][k + 1][h];
    for (int k = 0; k < FUNCTIONS; k++) {
      const double *f = k == 0 ? sum : profiles[m][k];
      bends_of(f, bends[k]);
      bottom[k] = f[0];
    }
    for (int g = 0; g < GRID; g++) {
      blurred((const double(*)[LIMB_H + 1])bends, bottom, FUNCTIONS, sigma, grid_low + g * grid_step, value,
              &slope_of[m][g], &blur_of[m][g]);
      for (int k = 0; k < FUNCTIONS; k++) value_of[m][k][g] = value[k];
    }
  }
}

static double read_grid(const double *table, double at) {
  int i = (int)at;
  return table[i] + (at - i) * (table[i + 1] - table[i]);
}

static double azimuth_of(const double *u) { return atan2(dot(axis_b, u), dot(axis_a, u)); }

/* Chooses the pixels near the limb and the nodes along it; 0 if there is too little limb. */
static int choose(const State *s) {
  double pixel_m = 0.0, nadir[3], spare[3] = {0, 0, 0}, low = limb_height_m[0], top = limb_height_m[LIMB_H - 1];
  double up = dot(s->r, s->r), to_limb = sqrt(up - A_M * A_M), central = sqrt(fmax(1.0 - A_M * A_M / up, 0.0));
  pixel_m = to_limb / fmax(fx, fy);
  double rim = 2.5 * s->blur * pixel_m, bottom = fmax(low + rim, s->lift - fmax(DEPTH_M, DEPTH_PX * pixel_m));
  top += fmax(rim, SPACE_PX * pixel_m) + s->lift;
  nadir_of(s, nadir);
  spare[fabs(nadir[0]) < 0.7 ? 0 : 1] = 1.0;
  cross(nadir, spare, axis_a);
  unit(axis_a);
  cross(nadir, axis_a, axis_b);
  /* where the limb is, in bins of azimuth; the largest gap is where it is not */
  static char seen[3600];
  memset(seen, 0, sizeof seen);
  count = 0;
  for (int row = 0; row < height; row++)
    for (int column = 0; column < width; column++) {
      Pixel *p = &near_[count];
      double by_column[3], by_row[3];
      sight(column, row, p->u, by_column, by_row);
      if (!lowest(s, p->u, &p->h, &p->distance, p->n) || p->h < bottom || p->h > top) continue;
      p->width_m = p->distance * hypot(dot(p->n, by_column), dot(p->n, by_row));
      p->value = image[row * width + column];
      p->light = pow(p->u[2], 4.0);
      p->weight = 1.0;
      int bin = (int)((azimuth_of(p->u) + PI) / (2.0 * PI) * 3600.0) % 3600;
      if (fabs(p->h) < 0.5 * p->width_m) seen[bin] = 1;
      if (++count == MOST_NEAR) return 0;
    }
  int gap = 0, run = 0, end = 0, limb = 0;
  for (int i = 0; i < 7200; i++) {
    run = seen[i % 3600] ? 0 : run + 1;
    if (run > gap && run <= 3600) gap = run, end = i + 1;
    limb += i < 3600 && seen[i];
  }
  if (limb < 8) return 0;
  double start = (end % 3600) / 3600.0 * 2.0 * PI - PI, arc = (3600 - gap) / 3600.0 * 2.0 * PI;
  nodes = (int)ceil(arc * central / NODE_RAD) + 1;
  nodes = nodes < 3 ? 3 : nodes > MOST_NODES ? MOST_NODES : nodes;
  double sums[MOST_NODES] = {0}, numbers[MOST_NODES] = {0}, largest = 0.0;
  int kept = 0;
  for (int i = 0; i < count; i++) {
    double away = fmod(azimuth_of(near_[i].u) - start + 4.0 * PI, 2.0 * PI);
    if (away > arc) away = away - arc < 2.0 * PI - away ? arc : 0.0;
    double at = away / arc * (nodes - 1);
    near_[i].node = at >= nodes - 1 ? nodes - 2 : (int)at;
    near_[i].share = at - near_[i].node;
    if (fabs(near_[i].h) < near_[i].width_m)
      sums[(int)(at + 0.5)] += near_[i].width_m, numbers[(int)(at + 0.5)] += 1.0;
    if (near_[i].light > largest) largest = near_[i].light;
    near_[kept++] = near_[i];
  }
  double cosine = sqrt(1.0 - central * central);
  for (int m = 0; m < nodes; m++) {
    double azimuth = start + arc * m / (nodes - 1), u[3];
    node_azimuth[m] = azimuth;
    node_width[m] = numbers[m] > 0.0 ? sums[m] / numbers[m] : pixel_m;
    /* the limb's angle from the nadir has the sine R / r, the cosine of the angle at the centre */
    for (int i = 0; i < 3; i++)
      u[i] = cosine * (cos(azimuth) * axis_a[i] + sin(azimuth) * axis_b[i]) + central * nadir[i];
    at_direction(s, u, profiles[m], node_place[m]);
  }
  for (int i = 0; i < count; i++) near_[i].light /= largest;
  grid_low = bottom - 5.0 * rim;
  grid_step = (top + 5.0 * rim - grid_low) / (GRID - 1);
  return 1;
}

static int cholesky(double (*M)[MOST_UNKNOWNS], int n) {
  for (int j = 0; j < n; j++)
    for (int i = j; i < n; i++) {
      double s = M[i][j];
      for (int k = 0; k < j; k++) s -= M[i][k] * M[j][k];
      if (i == j) {
        if (s <= 0.0) return 0;
        M[j][j] = sqrt(s);
      } else {
        M[i][j] = s / M[j][j];
      }
    }
  return 1;
}

static void solve(double (*M)[MOST_UNKNOWNS], int n, double *x) {
  for (int i = 0; i < n; i++) {
    for (int k = 0; k < i; k++) x[i] -= M[i][k] * x[k];
    x[i] /= M[i][i];
  }
  for (int i = n - 1; i >= 0; i--) {
    for (int k = i + 1; k < n; k++) x[i] -= M[k][i] * x[k];
    x[i] /= M[i][i];
  }
}

/* Information of the modes' coefficients: the inverse of their covariance along the limb. */
static int information(void) {
  for (int k = 0; k < LIMB_K; k++) {
    for (int i = 0; i < nodes; i++)
      for (int j = 0; j < nodes; j++) {
        double d2 = 0.0;
        for (int c = 0; c < 3; c++) d2 += pow(node_place[i][c] - node_place[j][c], 2.0);
        L[i][j] = exp(-0.5 * d2 / pow(limb_correlation_rad[k], 2.0)) + (i == j ? 1e-4 : 0.0);
      }
    if (!cholesky(L, nodes)) return 0;
    for (int j = 0; j < nodes; j++) {
      double e[MOST_NODES] = {0};
      e[j] = 1.0;
      solve(L, nodes, e);
      for (int i = 0; i < nodes; i++) prior_information[k][i][j] = e[i];
    }
  }
  return 1;
}

static double level_of(const State *s, const Pixel *p, double *at) {
  double x = p->h - s->lift;
  *at = fmin(fmax((x - grid_low) / grid_step, 0.0), GRID - 1.001);
  return (1.0 - p->share) * read_grid(value_of[p->node][0], *at) + p->share * read_grid(value_of[p->node + 1][0], *at);
}

/* Gain and background that fit best. */
static int levels(State *s) {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0, at;
  for (int i = 0; i < count; i++) {
    double level = near_[i].light * level_of(s, &near_[i], &at), w = near_[i].weight;
    n += w, x += w * level, y += w * near_[i].value, xx += w * level * level, xy += w * level * near_[i].value;
  }
  double determinant = n * xx - x * x;
  if (determinant <= 0.0) return 0;
  s->gain = (n * xy - x * y) / determinant;
  s->background = (y - s->gain * x) / n;
  return s->gain > 0.0;
}

/* Weighs by the residuals: a straight line of variance in brightness, five standard deviations at most. */
static void weigh(const State *s) {
  double most = 0.0, at;
  for (int i = 0; i < count; i++) most = fmax(most, near_[i].light * level_of(s, &near_[i], &at));
  for (int round = 0; round < 2; round++) {
    double sums[2] = {0, 0}, numbers[2] = {0, 0};
    for (int i = 0; i < count; i++) {
      double level = near_[i].light * level_of(s, &near_[i], &at);
      double off = near_[i].value - s->background - s->gain * level;
      int bright = level > 0.5 * most, dark = level < 0.05 * most;
      if ((bright || dark) && near_[i].weight > 0.0) sums[bright] += off * off, numbers[bright] += 1.0;
    }
    double dark = numbers[0] > 20 ? sums[0] / numbers[0] : 0.0, bright = numbers[1] > 20 ? sums[1] / numbers[1] : dark;
    /* what rounding to whole numbers alone makes */
    dark = fmax(dark, PIXEL_VARIANCE), bright = fmax(bright, PIXEL_VARIANCE);
    for (int i = 0; i < count; i++) {
      double level = near_[i].light * level_of(s, &near_[i], &at);
      double off = near_[i].value - s->background - s->gain * level;
      double variance = dark + (bright - dark) * fmin(fmax(level / most, 0.0), 1.0);
      near_[i].weight = off * off < OUTLIER * OUTLIER * variance ? 1.0 / variance : 0.0;
    }
  }
}

static void look(State *s) {
  for (int i = 0; i < count; i++) lowest(s, near_[i].u, &near_[i].h, &near_[i].distance, near_[i].n);
  fill_grid(s);
}

/* Normal equations at the present state; returns the number of unknowns. */
static int equations(const State *s, const State *mean) {
  int n = SHARED + nodes * LIMB_K;
  double J[SHARED + 2 * LIMB_K + 2], w[3];
  int place[SHARED + 2 * LIMB_K + 2];
  for (int i = 0; i < n; i++) {
    right_[i] = 0.0;
    for (int j = 0; j < n; j++) N[i][j] = 0.0;
  }
  for (int p = 0; p < count; p++) {
    const Pixel *x = &near_[p];
    if (x->weight == 0.0) continue;
    double at, level = level_of(s, x, &at), amplitude = s->gain * x->light, along[2] = {1.0 - x->share, x->share};
    double slope = 0.0, by_blur = 0.0, arm[3], n_itrs[3];
    for (int e = 0; e < 2; e++) {
      slope += along[e] * read_grid(slope_of[x->node + e], at);
      by_blur += along[e] * read_grid(blur_of[x->node + e], at);
    }
    double by_height = amplitude * slope;
    cross(x->u, x->n, arm);
    times_transposed((double(*)[3])s->R, x->n, n_itrs);
    for (int i = 0; i < 3; i++) J[i] = -by_height * x->distance * arm[i], J[3 + i] = by_height * n_itrs[i];
    J[6] = -by_height;
    J[7] = amplitude * by_blur;
    J[8] = amplitude * level;
    J[9] = 1.0;
    for (int i = 0; i < SHARED; i++) place[i] = i;
    int m = SHARED;
    for (int e = 0; e < 2; e++)
      for (int k = 0; k < LIMB_K; k++, m++) {
        J[m] = amplitude * along[e] * read_grid(value_of[x->node + e][k + 1], at);
        place[m] = SHARED + (x->node + e) * LIMB_K + k;
      }
    double off = x->value - s->background - amplitude * level;
    for (int i = 0; i < m; i++) {
      double weighted = x->weight * J[i];
      right_[place[i]] += weighted * off;
      for (int j = 0; j < m; j++) N[place[i]][place[j]] += weighted * J[j];
    }
  }
  turn_between((double(*)[3])mean->R, (double(*)[3])s->R, w);
  for (int i = 0; i < 3; i++) {
    N[i][i] += 1.0 / (sigma_q * sigma_q), right_[i] += w[i] / (sigma_q * sigma_q);
    N[3 + i][3 + i] += 1.0 / (sigma_r * sigma_r), right_[3 + i] += (mean->r[i] - s->r[i]) / (sigma_r * sigma_r);
  }
  N[6][6] += 1.0 / (lift_sigma * lift_sigma), right_[6] -= s->lift / (lift_sigma * lift_sigma);
  N[7][7] += 1.0 / (blur_sigma * blur_sigma), right_[7] += log(mean->blur / s->blur) / (blur_sigma * blur_sigma);
  for (int k = 0; k < LIMB_K; k++)
    for (int i = 0; i < nodes; i++)
      for (int j = 0; j < nodes; j++) {
        int a = SHARED + i * LIMB_K + k, b = SHARED + j * LIMB_K + k;
        N[a][b] += prior_information[k][i][j];
        right_[a] -= prior_information[k][i][j] * s->a[j][k];
      }
  return n;
}

static void move(State *s, const double *step) {
  turn(s->R, step);
  for (int i = 0; i < 3; i++) s->r[i] += step[3 + i];
  s->lift += step[6];
  s->blur *= exp(fmin(fmax(step[7], -0.5), 0.5));
  s->gain *= exp(fmin(fmax(step[8], -0.5), 0.5));
  s->background += step[9];
  for (int m = 0; m < nodes; m++)
    for (int k = 0; k < LIMB_K; k++) s->a[m][k] += step[SHARED + m * LIMB_K + k];
}

/* How unlike the image the mean profile is at a tilt, on every stride-th pixel: the residual's share of the variance. */
static double unlike(const State *s, const double *curve, double low, double step, int size, int stride) {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0, h, distance, normal[3], u[3], spare[3], other[3];
  for (int row = stride / 2; row < height; row += stride)
    for (int column = stride / 2; column < width; column += stride) {
      sight(column, row, u, spare, other);
      double at = size - 2.0;
      if (lowest(s, u, &h, &distance, normal)) at = fmin(fmax((h - low) / step, 0.0), size - 2.0);
      double level = pow(u[2], 4.0) * read_grid(curve, at), value = image[row * width + column];
      n += 1, x += level, y += value, xx += level * level, xy += level * value, yy += value * value;
    }
  double vx = xx - x * x / n, vy = yy - y * y / n, c = xy - x * y / n;
  return c <= 0.0 || vx <= 0.0 || vy <= 0.0 ? 1.0 : 1.0 - c * c / (vx * vy);
}

/* The tilt near the prior's attitude at which the predicted picture is most like the image. */
static void start(State *s) {
  static double curve[GRID], found[FUNCTIONS][LIMB_H];
  double nadir[3], u[3], place[3], up = dot(s->r, s->r), central = sqrt(1.0 - A_M * A_M / up), best_[2] = {0, 0};
  int stride = (int)fmax(1.0, sqrt(width * (double)height / 8000.0));
  double step = 2.0 * stride / fmax(fx, fy), reach = fmin(3.0 * sigma_q, 0.2);
  nadir_of(s, nadir);
  double spare[3] = {0, 0, 0};
  spare[fabs(nadir[0]) < 0.7 ? 0 : 1] = 1.0;
  cross(nadir, spare, axis_a);
  unit(axis_a);
  cross(nadir, axis_a, axis_b);
  /* the limb nearest to the middle of the image stands for all of it */
  double middle[3] = {0.0, 0.0, 1.0}, azimuth = azimuth_of(middle);
  for (int i = 0; i < 3; i++)
    u[i] = A_M / sqrt(up) * (cos(azimuth) * axis_a[i] + sin(azimuth) * axis_b[i]) + central * nadir[i];
  at_direction(s, u, found, place);
  double pixel_m = sqrt(up - A_M * A_M) / fmax(fx, fy), low = limb_height_m[0], high = 100e3 + 20.0 * stride * pixel_m;
  double fine = (high - low) / (GRID - 1);
  State mean = *s;
  static double bends[1][LIMB_H + 1];
  bends_of(found[0], bends[0]);
  for (int round = 0; round < 6; round++) {
    double sigma = 0.6 * step * pixel_m * fmax(fx, fy) + s->blur * pixel_m, slope, by_log;
    for (int g = 0; g < GRID; g++)
      blurred((const double(*)[LIMB_H + 1])bends, found[0], 1, sigma, low + g * fine, &curve[g], &slope, &by_log);
    double best = 2.0, centre[2] = {best_[0], best_[1]};
    int many = round == 0 ? (int)ceil(reach / step) : 2;
    for (int i = -many; i <= many; i++)
      for (int j = -many; j <= many; j++) {
        double t[2] = {centre[0] + i * step, centre[1] + j * step}, w[3];
        for (int c = 0; c < 3; c++) w[c] = t[0] * axis_a[c] + t[1] * axis_b[c];
        State tried = mean;
        turn(tried.R, w);
        /* of two alike the one nearer to the prior */
        double merit = unlike(&tried, curve, low, fine, GRID, stride) + 1e-3 * (t[0] * t[0] + t[1] * t[1]) / (sigma_q * sigma_q);
        if (merit < best) best = merit, best_[0] = t[0], best_[1] = t[1];
      }
    step *= 0.5;
  }
  double w[3];
  for (int c = 0; c < 3; c++) w[c] = best_[0] * axis_a[c] + best_[1] * axis_b[c];
  turn(s->R, w);
}

static int refuse(const char *status, const char *reason) {
  printf("{\"status\": \"%s\", \"reason\": \"%s\"}\n", status, reason);
  return 0;
}

int main(void) {
  static State s, mean;
  double q[4];
  if (scanf("%d %d %lf %lf %lf %lf", &width, &height, &fx, &fy, &cx, &cy) != 6 ||
      scanf("%lf %lf %lf %lf", &s.r[0], &s.r[1], &s.r[2], &sigma_r) != 4 ||
      scanf("%lf %lf %lf %lf %lf", &q[0], &q[1], &q[2], &q[3], &sigma_q) != 5 ||
      scanf("%lf %lf %lf %lf", &month, &sun[0], &sun[1], &sun[2]) != 4 ||
      scanf("%lf %lf %lf", &blur_prior, &blur_sigma, &lift_sigma) != 3 || getchar() != '\n' || width < 8 ||
      height < 8 || (long)width * height > MOST_PIXELS ||
      fread(image, sizeof *image, (size_t)width * height, stdin) != (size_t)width * height)
    return refuse("bad_input", "the image or what is known beside it cannot be read");
  double x = q[0], y = q[1], z = q[2], w = q[3];
  double R[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
                    {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
                    {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
  memcpy(s.R, R, sizeof R);
  if (dot(s.r, s.r) < A_M * A_M * 1.0001) return refuse("bad_input", "the position lies in the Earth");
  s.blur = sqrt(blur_prior * blur_prior + PIXEL_VARIANCE);
  s.gain = 1.0;
  mean = s;
  start(&s);
  if (!choose(&s) || !information()) return refuse("no_limb", "too little limb in view");
  look(&s);
  if (!levels(&s)) return refuse("no_limb", "the image is not brighter where the limb should be");
  weigh(&s);
  double step[MOST_UNKNOWNS], last[3] = {0, 0, 0}, damping = 1.0;
  int n = 0, settled = 0, steps = 0;
  for (; steps < 25 && settled < 2; steps++) {
    n = equations(&s, &mean);
    for (int i = 0; i < n; i++) memcpy(L[i], N[i], sizeof(double) * n);
    if (!cholesky(L, n)) return refuse("not_converged", "the equations are singular");
    memcpy(step, right_, sizeof(double) * n);
    solve(L, n, step);
    /* a turn about the nadir hardly changes the image */
    double down[3], about, moved, limit;
    nadir_of(&s, down);
    about = dot(step, down);
    moved = sqrt(fmax(dot(step, step) - about * about, 0.0)) * fmax(fx, fy);
    limit = moved > 3.0 ? 3.0 / moved : 1.0;
    /* Gauss-Newton may swing about the answer: a step that goes back on the last is halved, and those after it too */
    if (dot(step, last) < 0.0) damping *= 0.5;
    memcpy(last, step, sizeof last);
    for (int i = 0; i < n; i++) step[i] *= limit * damping;
    move(&s, step);
    if (moved > 1.0) {
      int had = nodes;
      if (!choose(&s)) return refuse("no_limb", "too little limb in view");
      if (nodes != had) memset(s.a, 0, sizeof s.a);
      if (!information()) return refuse("not_converged", "the equations are singular");
    }
    look(&s);
    if (steps < 6) weigh(&s);
    settled = moved < SETTLED_PX ? settled + 1 : 0;
  }
  if (settled < 2) return refuse("not_converged", "no convergence");
  n = equations(&s, &mean);
  for (int i = 0; i < n; i++) memcpy(L[i], N[i], sizeof(double) * n);
  if (!cholesky(L, n)) return refuse("not_converged", "the equations are singular");
  /* nadir = -R r / |r|: by the turn w it moves by w x nadir, by the position by -R (across r) / |r| */
  double nadir[3], variance = 0.0, norm = sqrt(dot(s.r, s.r)), explained = 0.0, whole = 0.0, average = 0.0, at;
  nadir_of(&s, nadir);
  for (int c = 0; c < 3; c++) {
    double e[3] = {0, 0, 0}, g[MOST_UNKNOWNS] = {0}, f[MOST_UNKNOWNS], arm[3], down[3];
    e[c] = 1.0;
    cross(nadir, e, arm);
    times_transposed(s.R, e, down);
    double radial = dot(down, s.r) / (norm * norm);
    for (int i = 0; i < 3; i++) g[i] = arm[i], g[3 + i] = -(down[i] - radial * s.r[i]) / norm;
    memcpy(f, g, sizeof f);
    solve(L, n, f);
    for (int i = 0; i < n; i++) variance += g[i] * f[i];
  }
  for (int i = 0; i < count; i++) average += near_[i].value / count;
  for (int i = 0; i < count; i++) {
    double off = near_[i].value - s.background - s.gain * near_[i].light * level_of(&s, &near_[i], &at);
    explained += off * off, whole += pow(near_[i].value - average, 2.0);
  }
  if (explained > 0.3 * whole) return refuse("no_limb", "the predicted limb explains too little of the image");
  printf("{\"status\": \"valid\", \"nadir_cam\": [%.12f, %.12f, %.12f], \"sigma_nadir_arcsec\": %.4f, ", nadir[0], nadir[1],
         nadir[2], sqrt(variance) * 180.0 / PI * 3600.0);
  printf("\"reason\": \"%d steps, %d pixels, %d nodes\"}\n", steps, count, nodes);
  return 0;
}
