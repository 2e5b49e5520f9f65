/* The tilt of a camera from one image of the limb, by rendered profiles: a reference for a flight computer. C99, no
   allocation, no library but libm. It reads table.h of `horizonval templates` and has the model, the priors and the noise
   of the estimator `limb-profile` of horizonval, so that one can be held against the other.

   A pixel whose line of sight passes at the height h over the ellipsoid (below 0: how deep it would come), between two
   nodes along the limb, is

       I = background + gain * light * P_s(y(h - lift) + c (s^2 + 1/12)) + noise,     P = mean + sum of a_k f_k

   P_s is the profile at the nodes, linear between them, as the pixel's two sides and a lens of s pixels blur it, and
   light the cosine of the off-axis angle to the fourth. y is the way across the limb in which pixels are even,
   h = y - curve y^2, and c (s^2 + 1/12) what a blur does to a limb that is bent in the image. The functions f_k are the
   table's modes, once more where lines end in other air, bumps over height for what the modes leave over, and the mean
   itself for a gain that varies along the limb. Unknown are turn (3), position (3), lift, the logarithms of blur and
   gain, sharpness of the lens, background, and unit unknowns z behind the coefficients at the nodes, a_k = W_k z, with
   W W^T their covariance exp(-d^2 / 2 l^2) for nodes a distance d apart at the Earth's centre. Priors are rows of the
   same normal equations, W weighs pixels by their noise:

       step = (J^T W J + Q)^-1 (J^T W residuals + Q (prior - now)),        C = (J^T W J + Q)^-1

   The noise is found in the residuals: of dark pixels, as bright as the pixel, as the square of what clouds can change
   through lens and pixel, as the slope's square; not less than rounding and what is left out of the air make. Where
   residuals are alike several pixels count as one (wider), the more of them the more of their variance is not
   that of dark pixels. The noise depends on the level, and what is made smallest is

       sum (residual^2 / variance + ln variance) / wider + priors

   of which residual + (residual^2 / variance - 1) (d variance / d level) / 2 is the slope by a pixel's level. In the
   first part of the way noise is held for a step, and the lens near its prior. Where the
   converter cuts noise off at its lowest level, dark pixels are taken for what they then show in the mean. Pixels and
   noise are chosen anew until both stand still, closer than `limb-profile` asks for, so that an answer depends little on
   where the search started.

   Left out: lenses with distortion, what is told of a lens's diffraction and of its blur over the field, the refusal
   of a lens that is softer at one part of the limb, planets that are spheres, sigmas of the attitude by axis, and fewer
   pixels in the first part of the way. A saturated pixel is known by full_scale alone. Not as in `limb-profile`:
   MOST_NODES, half of what it has at most, which is less only where more than 1.1 rad of limb at the Earth's centre are
   in view; and MOST_NEAR pixels near the limb.

   Standard input: one line of 28 numbers, and then width * height values of 16 bits in the machine's order, row by row:
     width height fx fy cx cy                  pixels
     rx ry rz  sigma_position                  m, Earth-fixed axes
     qx qy qz qw  sigma_attitude               from Earth-fixed to camera axes; rad, about any axis
     month                                     1.0 in the middle of January
     sx sy sz                                  towards the Sun as a sensor reads it, or as time and attitude say it;
                                               camera axes, unit vector
     tx ty tz                                  towards the Sun as the time says it, Earth-fixed axes; 0 0 0: it is not said
     blur  blur_log_sigma  lift_sigma          px of the lens, m
     gain  gain_log_sigma                      values per radiance of the table on the axis; sigma 0 without calibration
     full_scale                                value of a saturated pixel; 0: none is
   Standard output: one JSON object, as docs/howto/estimator-program.md says; beside its keys q_cam_from_itrs,
   position_itrs_km and lift_m. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "maths.h"
#include "table.h"

#define MOST_PIXELS (2048 * 2048)
#define MOST_NEAR 200000
#define MOST_SIDE 32767
#define MOST_SQUARES (MOST_PIXELS / 16 + MOST_SIDE / 2 + 1) /* of 4 pixels a side, in an image of any shape */
#define MOST_NODES 33
#define BUMPS 15
#define FUNCTIONS (1 + 2 * LIMB_K + BUMPS + 1)
#define SETS (LIMB_K + 2)
#define MOST_UNKNOWNS (SHARED + MOST_NODES * (FUNCTIONS - 1))

/* Shared unknowns; the pose comes last, so that the last rows of Cholesky's triangle are what is known of it. */
enum { BLUR, SHARPNESS, GAIN, BACKGROUND, TURN, POSITION = TURN + 3, LIFT = POSITION + 3, SHARED };
enum { POSE = SHARED - TURN };

static const double A_M = 6378137.0, EARTH_M = 6.371e6, PIXEL_VARIANCE = 1.0 / 12.0;
static const double SHARPNESS_PRIOR = 0.5, SHARPNESS_SIGMA = 0.5;
/* Window of heights, and grid beyond it. */
static const double DEPTH_PX = 0.5, SPACE_PX = 4.0, EDGE_BLURS = 2.5, GRID_RIMS = 2.0, NODE_RAD = 0.035;
enum { BORDER_PX = 2, FEWEST_LIMB_PX = 8 };
/* Air. */
static const double LEFT_OUT = 1e-5, BUMP_M = 6e3, LOWEST_BUMP_M = -15e3, LEAST_BUMP = 3e-3, LEAST_LEFT = 5e-5, LEAST_APART = 0.05;
static const double LEFT_LENGTH = 0.1, AIR_GAIN_SIGMA = 0.01, AIR_GAIN_LENGTH = 0.3, ENDS_STEP = 0.05, AT_POLE = 1e-9;
static const double SUNLIT_M = -20e3, SUNLIT_STEP_M = 20e3;
/* Noise. */
static const double OUTLIER = 5.0, CLOUD_TOP_M = 16e3, DARK = 0.05, BRIGHT = 0.5, QUARTILE = 0.67448975;
static const double LEAST_ALIKE = 1.1, SURELY_ALIKE = 1.3;
static const double LEAST_SHARE_DARK = 0.01;
enum { FEWEST_PIXELS = 20, WEIGHINGS = 3, FEWEST_DARK = 50 };
/* Steps. */
enum { MOST_STEPS = 40, SETTLING_STEPS = 2, MOST_TRIALS = 8, MOST_ROUNDS = 8 };
static const double SETTLED = 0.03, NEARLY_SETTLED = 1.0, STEADY = 0.03, CONVERGED = 1e-3, HELD = 10.0;
static const double RESELECT_PX = 1.0, CLOSE_PX = 0.005, ROUNDING = 1e-3, WORTH = 0.002;
static const double LARGEST_M = 15e3, LARGEST_PX = 3.0, LARGEST_LOG = 0.5, LEAST_GAIN = 0.2;
static const double FINEST_M = 4e3, FINEST_PX = 0.5;
static const double LEAST_SHARE = 0.1, MOST_SHARE = 0.7, MOST_ROUND = 0.5, ROUNDED = 1e-4;
/* What is believed. */
static const double SCATTERED = 2.0, LEAST_EXPLAINED = 0.95, MOST_IMPROBABLE = 6.0, MOST_SIGMA = 5.0;

typedef struct {
  double R[3][3], r[3], lift;                        /* for which the pixels were chosen */
  double away[POSE];                                 /* from there: turn, position, lift */
  double blur, sharpness, gain, background, z[MOST_UNKNOWNS - SHARED];
} State;
typedef struct {
  double value, light;                               /* of the image */
  double h, y, by_pose[POSE];                        /* height, and way across the limb with its derivatives */
  double share, level, slope, kept, off, weight;     /* of what is predicted, its change by light; 1 / variance */
  double variance, least, by_level, pull;            /* of the noise, its derivative by the level, what that adds to off */
  double below, brightest, left, shown, wider;       /* what noise is made of, and how many pixels count as one */
  float along;                                       /* from its node to the next */
  int16_t column, row, node, place;
} Pixel;
typedef struct {
  double width_m, box_m[2], lift_m;                  /* a pixel's way across the limb, its sides', and what blur lifts */
  double up[3], north[3], length[LIMB_K + 1][2];     /* Earth-fixed; of modes along the meridian and the parallel */
  double mean[LIMB_H], modes[LIMB_K + 1][LIMB_H], left[LIMB_H], alike[LIMB_K + 1][LIMB_H];
} Node;

static uint16_t image[MOST_PIXELS];
static int width, height;
static double full_scale;
static double fx, fy, cx, cy, sigma_r, sigma_q, month, sun_read[3], sun_known[3], blur_sigma, lift_sigma, gain_sigma;
static State prior;

static Pixel near_[MOST_NEAR];
static Node node[MOST_NODES];
static int count, nodes, functions, unknowns, air;
static int first_part; /* of the way: noise is held for a step and not wider, and the lens near its prior */
static double curve, grid_low, grid_step, median_width, floor_level, floor_sigma, floor_space;
static int kind_of[FUNCTIONS], set_of[FUNCTIONS], offset_of[FUNCTIONS], rank_of[SETS], pivot_of[SETS][MOST_NODES];
static double wave[SETS][MOST_NODES][MOST_NODES];

static double transform[MOST_NODES][FUNCTIONS][GRID], smooth[MOST_NODES][GRID], sampled[MOST_NODES][GRID];
static double smooth_by_blur[MOST_NODES][GRID], sampled_by_blur[MOST_NODES][GRID];
static double level_at[MOST_NODES][GRID], slope_at[MOST_NODES][GRID], blur_at[MOST_NODES][GRID], sharp_at[MOST_NODES][GRID];
static float value_at[MOST_NODES][GRID][FUNCTIONS];
static double coefficient[MOST_NODES][FUNCTIONS];
static double N[MOST_UNKNOWNS][MOST_UNKNOWNS], L[MOST_UNKNOWNS][MOST_UNKNOWNS], right_[MOST_UNKNOWNS];
static double scratch[MOST_NEAR];

/* Line of sight of a pixel. */
static void sight(double column, double row, double *u) {
  u[0] = (column - cx) / fx, u[1] = (row - cy) / fy, u[2] = 1.0;
  unit(u);
}

/* Height of the lowest point, distance to it, and the normal there in Earth-fixed axes. */
static double lowest(const State *s, const double *u, double *distance, double *n) {
  static const double axes[3] = {6378137.0, 6378137.0, 6356752.314245};
  double d[3], p[3], e[3], q[3];
  times_transposed(s->R[0], u, d);
  for (int i = 0; i < 3; i++) p[i] = s->r[i] / axes[i], e[i] = d[i] / axes[i];
  *distance = -dot(p, e) / dot(e, e);
  for (int i = 0; i < 3; i++) q[i] = p[i] + *distance * e[i];
  double m = sqrt(dot(q, q));
  for (int i = 0; i < 3; i++) n[i] = q[i] / axes[i];
  double size = sqrt(dot(n, n));
  for (int i = 0; i < 3; i++) n[i] /= size;
  return (m - 1.0) * m / size;
}

/* The way y across the limb to a height, and its derivative. */
static double across(double h, double *by_height) {
  double root = sqrt(fmax(1.0 - 4.0 * curve * h, 0.01));
  *by_height = 1.0 / root;
  return 2.0 * h / (1.0 + root);
}

static double across_at(const State *s, double column, double row) {
  double u[3], n[3], distance, spare;
  sight(column, row, u);
  return across(lowest(s, u, &distance, n), &spare);
}

static void nadir_of(const State *s, double *nadir) {
  double down[3] = {-s->r[0], -s->r[1], -s->r[2]};
  unit(down);
  times(s->R[0], down, nadir);
}

/* The table */

static int before(const float *axis, int n, double x, double *share) {
  int i = 0;
  while (i < n - 2 && x >= axis[i + 1]) i++;
  *share = n == 1 ? 0.0 : clip((x - axis[i]) / (axis[i + 1] - axis[i]), 0.0, 1.0);
  return i;
}

/* A place of the limb in the table: four rows and their shares by straight lines, and what every row counts for by
   splines where the Sun shines. */
typedef struct {
  int corner[4];
  double share[4], curved[LIMB_A * LIMB_B];
} Place;

/* Zenith angles of the Sun: tables that reach beyond the first are taken for dark at the second. */
static const double TWILIGHT = 1.7104226669544429, DARK_AT = 1.8500490071139892, ROUNDED_RAD = 1e-6;
static float zenith[LIMB_A + 1];
static double of_zenith[(LIMB_A + 1) * (LIMB_A + 1)], of_azimuth[LIMB_B * LIMB_B];
static int zeniths;
static float root_of_mean[LIMB_A * LIMB_B * LIMB_H];

static void prepare_splines(void) {
  double spare[LIMB_A + LIMB_B + 1];
  zeniths = LIMB_A;
  memcpy(zenith, limb_first, sizeof limb_first);
  if (zenith[LIMB_A - 1] >= TWILIGHT && zenith[LIMB_A - 1] < DARK_AT) zenith[zeniths++] = DARK_AT;
  spline_slopes(zenith, zeniths, 0, 1, of_zenith, spare);
  spline_slopes(limb_second, LIMB_B, limb_second[0] < ROUNDED_RAD, limb_second[LIMB_B - 1] > PI - ROUNDED_RAD, of_azimuth,
                spare);
  for (int row = 0; row < LIMB_A * LIMB_B; row++)
    for (int h = 0; h < LIMB_H; h++)
      root_of_mean[row * LIMB_H + h] = sqrt(fmax(limb_mean_scale[row] * limb_mean[row * LIMB_H + h], 0.0));
}

/* Towards the Sun, camera axes: how far from the nadir it stands is as time and place say it, about it as it was read. */
static void sun_of(const State *s, double *sun) {
  if (dot(sun_known, sun_known) == 0.0) {
    for (int i = 0; i < 3; i++) sun[i] = sun_read[i];
    return;
  }
  double nadir[3], level[3], down = -dot(sun_known, s->r) / sqrt(dot(s->r, s->r)), along;
  nadir_of(s, nadir);
  along = dot(sun_read, nadir);
  for (int i = 0; i < 3; i++) level[i] = sun_read[i] - along * nadir[i];
  double size = sqrt(fmax(1.0 - down * down, 0.0)) / fmax(sqrt(dot(level, level)), 1e-9);
  for (int i = 0; i < 3; i++) sun[i] = down * nadir[i] + size * level[i];
}

/* Where a normal n and a line of sight u, camera axes, are in the table. */
static void find(const State *s, const double *n, const double *u, Place *at) {
  double a, b, first, second, up[3], row[LIMB_A + 1], column[LIMB_B];
  int i, j, next, below;
  if (LIMB_THERMAL) {
    times_transposed(s->R[0], n, up);
    first = asin(clip(up[2], -1.0, 1.0));
    second = limb_second[0] + fmod(fmod(month - limb_second[0], 12.0) + 12.0, 12.0);
    for (j = 0; j < LIMB_B - 1 && second >= limb_second[j + 1];) j++;
    next = (j + 1) % LIMB_B;
    double end = j + 1 < LIMB_B ? limb_second[next] : limb_second[0] + 12.0;
    b = (second - limb_second[j]) / (end - limb_second[j]);
  } else {
    double sun[3];
    sun_of(s, sun);
    cross(n, u, up);
    first = acos(clip(dot(n, sun), -1.0, 1.0));
    second = fabs(atan2(dot(up, sun), dot(u, sun)));
    j = before(limb_second, LIMB_B, second, &b);
    next = j + 1 < LIMB_B ? j + 1 : j;
    spline_weights(zenith, zeniths, of_zenith, first, row);
    spline_weights(limb_second, LIMB_B, of_azimuth, second, column);
    for (int k = 0; k < LIMB_A; k++)
      for (int l = 0; l < LIMB_B; l++) at->curved[k * LIMB_B + l] = row[k] * column[l];
  }
  i = before(limb_first, LIMB_A, first, &a);
  below = i + 1 < LIMB_A ? i + 1 : i;
  at->corner[0] = i * LIMB_B + j, at->corner[1] = i * LIMB_B + next;
  at->corner[2] = below * LIMB_B + j, at->corner[3] = below * LIMB_B + next;
  at->share[0] = (1 - a) * (1 - b), at->share[1] = (1 - a) * b, at->share[2] = a * (1 - b), at->share[3] = a * b;
}

static double mean_at(const Place *at, int h) {
  double sum = 0.0;
  if (LIMB_THERMAL) {
    for (int c = 0; c < 4; c++)
      sum += at->share[c] * limb_mean_scale[at->corner[c]] * limb_mean[at->corner[c] * LIMB_H + h];
    return sum;
  }
  for (int row = 0; row < LIMB_A * LIMB_B; row++) sum += at->curved[row] * root_of_mean[row * LIMB_H + h];
  return sum > 0.0 ? sum * sum : 0.0;
}

static double mode_at(const Place *at, int k, int h) {
  double sum = 0.0;
  int rows = LIMB_THERMAL ? 4 : LIMB_A * LIMB_B;
  for (int i = 0; i < rows; i++) {
    int row = (LIMB_THERMAL ? at->corner[i] : i) * (LIMB_K + 1) + k;
    sum += (LIMB_THERMAL ? at->share[i] : at->curved[i]) * limb_modes_scale[row] * limb_modes[row * LIMB_H + h];
  }
  return sum;
}

/* The table's profiles at a node whose line of sight is u. A line that passes below the height z from which light comes
   ends earlier, by the angle d = (2 (z - h) / R)^1/2: thermal means are those of the latitude there, and a mode is there
   alike with what it is at the lowest point as exp(-d^2 / 2 l^2), l its length along the line. A line that passes h above
   the limb, l away, is turned by h / l and has its lowest point as much nearer: sunlit means are those of the Sun there. */
static void look_up(const State *s, const double *u, Node *at) {
  enum { ENDS = 6 };
  static Place here, end[ENDS];
  double n[3], line_fixed[3], along[LIMB_K + 1], distance;
  lowest(s, u, &distance, at->up);
  times(s->R[0], at->up, n);
  find(s, n, u, &here);
  at->north[0] = -at->up[2] * at->up[0], at->north[1] = -at->up[2] * at->up[1], at->north[2] = 1.0 - at->up[2] * at->up[2];
  double level = sqrt(dot(at->north, at->north));
  for (int i = 0; i < 3; i++) at->north[i] = level > AT_POLE ? at->north[i] / level : 0.0;
  times_transposed(s->R[0], u, line_fixed);
  double northward = pow(dot(at->north, line_fixed), 2.0);
  for (int k = 0; k < LIMB_K; k++) {
    for (int i = 0; i < 2; i++) {
      at->length[k][i] = 0.0;
      for (int c = 0; c < 4; c++)
        at->length[k][i] += here.share[c] * limb_correlation_rad[(here.corner[c] / LIMB_B * (LIMB_K + 1) + k) * 2 + i];
    }
    if (level <= AT_POLE) at->length[k][0] = at->length[k][1];
    along[k] = 1.0 / sqrt(northward / pow(at->length[k][0], 2.0) + (1.0 - northward) / pow(at->length[k][1], 2.0));
  }
  for (int h = 0; h < LIMB_H; h++) {
    at->mean[h] = mean_at(&here, h);
    at->left[h] = 0.0;
    for (int c = 0; c < 4; c++)
      at->left[h] += here.share[c] * limb_left_scale[here.corner[c]] * limb_left[here.corner[c] * LIMB_H + h];
    for (int k = 0; k < LIMB_K; k++) at->modes[k][h] = mode_at(&here, k, h);
  }
  for (int e = 0; e < ENDS; e++) {
    double angle = LIMB_THERMAL ? e * ENDS_STEP : (SUNLIT_M + e * SUNLIT_STEP_M) * sqrt(2.0 * curve / EARTH_M);
    double up[3], line[3];
    for (int i = 0; i < 3; i++) up[i] = cos(angle) * n[i] - sin(angle) * u[i], line[i] = cos(angle) * u[i] + sin(angle) * n[i];
    find(s, up, LIMB_THERMAL ? u : line, &end[e]);
  }
  if (!LIMB_THERMAL)
    for (int h = 0; h < LIMB_H; h++) {
      double place = clip((limb_height_m[h] - SUNLIT_M) / SUNLIT_STEP_M, 0.0, ENDS - 1.0);
      int e = place < ENDS - 2 ? (int)place : ENDS - 2;
      at->mean[h] = (e + 1 - place) * mean_at(&end[e], h) + (place - e) * mean_at(&end[e + 1], h);
    }
  /* thermal means are moved by their own brightest height, the modes by that of the moved means */
  for (int pass = LIMB_THERMAL ? 0 : 1; pass < 2; pass++) {
    double largest = 0.0, source = 0.0;
    for (int h = 0; h < LIMB_H; h++) largest = fmax(largest, at->mean[h]);
    for (int h = 0; h < LIMB_H; h++)
      if (at->mean[h] >= 0.5 * largest) source = limb_height_m[h];
    for (int h = 0; h < LIMB_H; h++) {
      double away = sqrt(fmax(2.0 * (source - limb_height_m[h]) / EARTH_M, 0.0)), place = fmin(away / ENDS_STEP, ENDS - 1.001);
      int e = (int)place;
      if (pass == 1)
        for (int k = 0; k < LIMB_K; k++) at->alike[k][h] = exp(-0.5 * pow(away / along[k], 2.0));
      else at->mean[h] = (e + 1 - place) * mean_at(&end[e], h) + (place - e) * mean_at(&end[e + 1], h);
    }
  }
}

/* Means of a profile over the grid's steps: the table's end below, nothing above but a metre in which it fades. */
static void even(const double *f, double *out) {
  enum { LAST = LIMB_H - 1 };
  const float *h = limb_height_m;
  double whole[LIMB_H] = {0}, sum_before = 0.0, z_before = 0.0;
  for (int j = 1; j < LIMB_H; j++) whole[j] = whole[j - 1] + 0.5 * (f[j] + f[j - 1]) * (h[j] - h[j - 1]);
  for (int i = 0, j = 0; i <= GRID; i++) {
    double y = grid_low + (i - 0.5) * grid_step, z = y - curve * y * y, sum, d;
    while (j < LAST - 1 && z >= h[j + 1]) j++;
    d = z < h[LAST] ? z - h[j] : fmin(z - h[LAST], 1.0);
    if (z <= h[0]) sum = d * f[0];
    else if (z < h[LAST]) sum = whole[j] + d * (f[j] + 0.5 * d * (f[j + 1] - f[j]) / (h[j + 1] - h[j]));
    else sum = whole[LAST] + f[LAST] * d * (1.0 - 0.5 * d);
    if (i > 0) out[i - 1] = (sum - sum_before) / (z - z_before);
    sum_before = sum, z_before = z;
  }
}

/* How alike a function is at two nodes, exp(-d^2 / 2 l^2) where its length is the same everywhere. With lengths l_n along
   the meridian and l_e along the parallel it varies at a node as one of the covariance S = l_e^2 1 + (l_n^2 - l_e^2) n n^T,
   and from one to the other (Paciorek and Schervish 2006, equation 1), S_m the mean of both,
   c = |S_i|^1/4 |S_j|^1/4 |S_m|^-1/2 exp(-d^T S_m^-1 d / 2). */
static double alike_at(const Node *i, const Node *j, int set) {
  double d[3], d2;
  for (int c = 0; c < 3; c++) d[c] = i->up[c] - j->up[c];
  d2 = dot(d, d);
  if (set >= LIMB_K) return exp(-0.5 * d2 / pow(set == LIMB_K ? LEFT_LENGTH : AIR_GAIN_LENGTH, 2.0));
  double in2 = pow(i->length[set][0], 2.0), ie2 = pow(i->length[set][1], 2.0);
  double jn2 = pow(j->length[set][0], 2.0), je2 = pow(j->length[set][1], 2.0);
  double a = 0.5 * (ie2 + je2), b = 0.5 * (in2 - ie2) / a, c = 0.5 * (jn2 - je2) / a;
  double g = dot(i->north, j->north), p = dot(i->north, d), q = dot(j->north, d);
  double D = (1.0 + b) * (1.0 + c) - b * c * g * g;
  double along = (b * (1.0 + c) * p * p - 2.0 * b * c * g * p * q + c * (1.0 + b) * q * q) / D;
  return pow(ie2 * ie2 * in2 * je2 * je2 * jn2, 0.25) / sqrt(a * a * a * D) * exp(-0.5 * (d2 - along) / a);
}

/* A square root of the covariance of the nodes, columns until little variance is left (Cholesky with pivots); returns how
   many. */
static int root_of_covariance(int set, double sigma, double W[MOST_NODES][MOST_NODES], int *pivots) {
  double left[MOST_NODES], sum = nodes;
  int rank = 0;
  for (int i = 0; i < nodes; i++) left[i] = 1.0;
  for (; rank < nodes && sum > LEFT_OUT * nodes; rank++) {
    int pivot = 0;
    for (int i = 1; i < nodes; i++)
      if (left[i] > left[pivot] + 1e-6) pivot = i;
    double size = sqrt(left[pivot]);
    pivots[rank] = pivot;
    sum = 0.0;
    for (int i = 0; i < nodes; i++) {
      double v = alike_at(&node[i], &node[pivot], set);
      for (int k = 0; k < rank; k++) v -= W[i][k] * W[pivot][k];
      W[i][rank] = v / size;
    }
    for (int i = 0; i < nodes; i++) {
      left[i] = i == pivot ? 0.0 : fmax(left[i] - W[i][rank] * W[i][rank], 0.0);
      sum += left[i];
    }
  }
  for (int i = 0; i < nodes; i++)
    for (int k = 0; k < rank; k++) W[i][k] *= sigma;
  return rank;
}

/* The window */

/* The pose moves to where its unknowns say it is. */
static void rest(State *s) {
  turn(s->R, s->away);
  for (int i = 0; i < 3; i++) s->r[i] += s->away[3 + i];
  s->lift += s->away[6];
  memset(s->away, 0, sizeof s->away);
}

/* Noise about the lowest level, of the share and the mean of dark pixels there; 0 where the floor cuts nothing off, or
   where too few pixels tell. Space without the floor is kept: far below it no pixel shows how far. */
static double noise_at_floor(int dark, double share, double mean) {
  double low = -10.0, high = 10.0, sigma = mean;
  if (dark < FEWEST_DARK || !(share > LEAST_SHARE_DARK && share < 1.0 - LEAST_SHARE_DARK && mean > 0.0)) return 0.0;
  for (int i = 0; i < 60; i++) {
    double middle = 0.5 * (low + high);
    if (normal(middle) < share) low = middle;
    else high = middle;
  }
  for (int i = 0; i < 20; i++) {
    double z = 0.5 / sigma - low;
    sigma = mean / (exp(-0.5 * z * z) / sqrt(2.0 * PI) + z * normal(z));
  }
  floor_space = floor_level + 0.5 - low * sigma;
  return sigma > 0.5 && sigma < 1e6 ? sigma : 0.0;
}

/* Whether a pixel or one beside it is saturated: below full scale by its noise alone, or with charge of others in it. */
static int clipped(int column, int row) {
  for (int i = -2; full_scale > 0.0 && i <= 2; i++)
    for (int j = -2; j <= 2; j++)
      if (row + i >= 0 && row + i < height && column + j >= 0 && column + j < width &&
          image[(row + i) * width + column + j] >= full_scale)
        return 1;
  return 0;
}

/* Chooses the pixels near the limb; 0 if there is too little limb. Nodes are as many pixels apart, from the end of the
   widest gap in azimuth on. */
static int choose(State *s) {
  double dark_above, dark_mean = 0.0;
  int dark = 0, at_floor = 0;
  rest(s);
  double r2 = dot(s->r, s->r), to_limb = sqrt(fmax(r2 - A_M * A_M, 1.0)), pixel_m = to_limb / fmax(fx, fy), spare;
  double rim = EDGE_BLURS * sqrt(s->blur * s->blur + PIXEL_VARIANCE) * pixel_m;
  double bottom = s->lift - DEPTH_PX * pixel_m;
  double top = limb_height_m[LIMB_H - 1] + fmax(rim, SPACE_PX * pixel_m) + s->lift, nadir[3], a[3], b[3];
  curve = 0.5 * A_M / fmax(r2 - A_M * A_M, 1.0);
  grid_low = across(bottom, &spare) - GRID_RIMS * rim;
  grid_step = (across(top, &spare) + GRID_RIMS * rim - grid_low) / HALF;
  dark_above = limb_height_m[LIMB_H - 1] + rim + s->lift;
  floor_level = image[0];
  for (int i = 1; i < width * height; i++) floor_level = fmin(floor_level, image[i]);
  nadir_of(s, nadir);
  basis(nadir, a, b);
  static double azimuth[MOST_NEAR], sorted[MOST_NEAR], on_limb[MOST_NEAR];
  int limb = 0;
  count = 0;
  for (int row = BORDER_PX; row < height - BORDER_PX; row++)
    for (int column = BORDER_PX; column < width - BORDER_PX; column++) {
      Pixel *p = &near_[count];
      double u[3], n[3], n_cam[3], arm[3], distance, by_height;
      sight(column, row, u);
      p->h = lowest(s, u, &distance, n);
      if (distance <= 0.0 || p->h <= bottom || p->h >= top || clipped(column, row)) continue;
      p->y = across(p->h - s->lift, &by_height);
      times(s->R[0], n, n_cam);
      cross(n_cam, u, arm);
      for (int i = 0; i < 3; i++) p->by_pose[i] = by_height * distance * arm[i], p->by_pose[3 + i] = by_height * n[i];
      p->by_pose[6] = -by_height;
      p->column = column, p->row = row;
      p->value = image[row * width + column];
      p->light = pow(u[2], 4.0);
      p->weight = 1.0;
      if (p->h > dark_above) dark++, at_floor += p->value <= floor_level, dark_mean += p->value - floor_level;
      azimuth[count] = sorted[count] = atan2(dot(b, u), dot(a, u));
      if (fabs(p->h) < pixel_m) {
        double by_column = across_at(s, column + 0.5, row) - across_at(s, column - 0.5, row);
        double by_row = across_at(s, column, row + 0.5) - across_at(s, column, row - 0.5);
        if (fabs(p->h) < 0.5 * hypot(by_column, by_row)) on_limb[limb++] = azimuth[count];
      }
      if (++count == MOST_NEAR) return 0;
    }
  if (limb < FEWEST_LIMB_PX) return 0;
  floor_sigma = noise_at_floor(dark, at_floor / fmax(dark, 1.0), dark_mean / fmax(dark, 1.0));
  sort(sorted, count);
  int first = 0;
  double gap = sorted[0] + 2.0 * PI - sorted[count - 1];
  for (int i = 1; i < count; i++)
    if (sorted[i] - sorted[i - 1] > gap) gap = sorted[i] - sorted[i - 1], first = i;
  double start = sorted[first], at_centre = sqrt(fmax(1.0 - A_M * A_M / r2, 0.0)), border[MOST_NODES], ends[2] = {1e9, -1e9};
  int sectors = (int)ceil((2.0 * PI - gap) * at_centre / NODE_RAD), most = limb / 2 < MOST_NODES - 1 ? limb / 2 : MOST_NODES - 1;
  sectors = sectors > most ? most : sectors < 2 ? 2 : sectors;
  nodes = sectors + 1;
  for (int m = 0; m < nodes; m++) {
    int i = (int)((double)m * count / sectors);
    double at = sorted[(first + (i < count ? i : count - 1)) % count] - start;
    border[m] = at < 0.0 ? at + 2.0 * PI : at;
  }
  for (int i = 0; i < limb; i++) {
    double at = fmod(on_limb[i] - start + 4.0 * PI, 2.0 * PI);
    ends[0] = fmin(ends[0], at), ends[1] = fmax(ends[1], at);
  }
  for (int i = 0; i < count; i++) {
    double at = azimuth[i] - start;
    if (at < 0.0) at += 2.0 * PI;
    int m = 0;
    while (m < sectors - 1 && at >= border[m + 1]) m++;
    near_[i].node = m;
    near_[i].along = clip((at - border[m]) / fmax(border[m + 1] - border[m], 1e-12), 0.0, 1.0);
  }
  double sine = sqrt(1.0 - at_centre * at_centre);
  for (int m = 0; m < nodes; m++) {
    double u[3], seen[3];
    /* what a pixel is at the ends is that of the last limb in view */
    for (int e = 0; e < 2; e++) {
      double t = start + (e ? clip(border[m], ends[0], ends[1]) : border[m]), *v = e ? seen : u;
      for (int i = 0; i < 3; i++) v[i] = sine * (cos(t) * a[i] + sin(t) * b[i]) + at_centre * nadir[i];
    }
    /* The limb of the ellipsoid is up to 21 km lower than that of a sphere. */
    for (int k = 0; k < 2; k++) {
      double n[3], n_cam[3], distance, h = lowest(s, u, &distance, n);
      times(s->R[0], n, n_cam);
      for (int i = 0; i < 3; i++) u[i] -= n_cam[i] * h / distance;
      unit(u);
    }
    look_up(s, u, &node[m]);
    double column = cx + fx * seen[0] / seen[2], row = cy + fy * seen[1] / seen[2], here = across_at(s, column, row);
    double left = across_at(s, column - 1.0, row), right = across_at(s, column + 1.0, row);
    double above = across_at(s, column, row - 1.0), below = across_at(s, column, row + 1.0);
    node[m].box_m[0] = 0.5 * fabs(right - left), node[m].box_m[1] = 0.5 * fabs(below - above);
    node[m].width_m = hypot(node[m].box_m[0], node[m].box_m[1]);
    node[m].lift_m = 0.5 * (left + right + above + below - 4.0 * here);
    scratch[m] = node[m].width_m;
  }
  median_width = median(scratch, nodes);
  for (int i = 0; i < count; i++) {
    double soft_m = sqrt(s->blur * s->blur + PIXEL_VARIANCE) * node[near_[i].node].width_m;
    near_[i].below = normal((CLOUD_TOP_M - near_[i].h) / soft_m);
  }
  return 1;
}

static double neglected[MOST_NODES][GRID];             /* what bumps that are left out would be */

/* Functions of all nodes on the grid, transformed and blurred by the pixel; how their coefficients come of unknowns. */
static void functions_of_air(void) {
  static double shape[LIMB_H], left[MOST_NODES][GRID], spare[GRID];
  int second[LIMB_K + 1] = {0}, bump[BUMPS] = {0};
  static double bump_of[BUMPS][GRID], largest_of[MOST_NODES];
  double last = grid_low + HALF * grid_step;
  for (int k = 0; k < SETS; k++)
    rank_of[k] = root_of_covariance(k, k == LIMB_K + 1 ? AIR_GAIN_SIGMA : 1.0, wave[k], pivot_of[k]);
  for (int j = 0; j < BUMPS; j++)
    for (int g = 0; g < GRID; g++) {
      double y = grid_low + g * grid_step, away = fabs(y - curve * y * y - LOWEST_BUMP_M - j * BUMP_M) / BUMP_M;
      bump_of[j][g] = cos(0.5 * PI * fmin(away, 1.0));
    }
  /* left out is what is too little everywhere */
  for (int m = 0; m < nodes; m++) {
    double largest = 0.0;
    even(node[m].mean, transform[m][0]);
    even(node[m].left, left[m]);
    for (int g = 0; g < GRID; g++) largest = fmax(largest, transform[m][0][g]);
    largest_of[m] = largest;
    for (int j = 0; j < BUMPS; j++)
      for (int g = 0; g < GRID; g++)
        if (left[m][g] * bump_of[j][g] > LEAST_BUMP * largest) bump[j] = 1;
    for (int k = 0; k < LIMB_K; k++)
      for (int h = 0; h < LIMB_H; h++)
        if (limb_height_m[h] > grid_low && limb_height_m[h] < last && 1.0 - pow(node[m].alike[k][h], 2.0) > LEAST_APART * LEAST_APART)
          second[k] = 1;
  }
  for (int g = 0; g < GRID; g++) {
    double y = grid_low + g * grid_step, out = y - curve * y * y > LOWEST_BUMP_M + BUMP_M ? 1.0 : 0.0;
    for (int j = 0; j < BUMPS; j++)
      if (bump[j] && out > 0.0) out = fmax(out - bump_of[j][g] * bump_of[j][g], 0.0);
    for (int m = 0; m < nodes; m++) neglected[m][g] = fmax(left[m][g], LEAST_LEFT * largest_of[m]) * sqrt(out);
  }
  for (int m = 0; m < nodes; m++) {
    double(*f)[GRID] = transform[m];
    functions = 1;
    for (int part = 0; part < 2; part++)
      for (int k = 0; k < LIMB_K; k++) {
        if (part == 1 && !second[k]) continue;
        for (int h = 0; h < LIMB_H; h++) {
          double alike = node[m].alike[k][h];
          shape[h] = node[m].modes[k][h] * (part == 0 ? alike : sqrt(1.0 - alike * alike));
        }
        set_of[functions] = k, kind_of[functions] = part * LIMB_K + k;
        even(shape, f[functions++]);
      }
    for (int j = 0; j < BUMPS; j++) {
      if (!bump[j]) continue;
      for (int g = 0; g < GRID; g++) f[functions][g] = left[m][g] * bump_of[j][g];
      set_of[functions] = LIMB_K, kind_of[functions++] = 2 * LIMB_K + j;
    }
    memcpy(f[functions], f[0], sizeof f[0]);
    set_of[functions] = LIMB_K + 1, kind_of[functions++] = 2 * LIMB_K + BUMPS;
    memset(spare, 0, sizeof spare);
    for (int k = 0; k < functions; k += 2) cosines(f[k], k + 1 < functions ? f[k + 1] : spare, 1.0);
    for (int g = 0; g < GRID; g++) {
      double frequency = g / (2.0 * HALF * grid_step);
      double pixel = sinc(node[m].box_m[0] * frequency) * sinc(node[m].box_m[1] * frequency);
      for (int k = 0; k < functions; k++) f[k][g] *= pixel;
    }
  }
  air = 0;
  for (int k = 1; k < functions; k++) {
    offset_of[k] = air;
    air += rank_of[set_of[k]];
  }
  unknowns = air + SHARED;
}

/* The lens's transform at the nodes and its change with the logarithm of the blur: a Gaussian, and one of samples at
   whole pixels (Chebyshev: cos (k + 1) x = 2 cos x cos k x - cos (k - 1) x). */
static void lens(double blur) {
  enum { MOST_PLACES = 64 };
  double weight[MOST_PLACES], steep[MOST_PLACES], sum = 1.0, sum_steep = 0.0, limit = fmax(blur, 0.15);
  int places = (int)fmin(ceil(5.0 * blur), MOST_PLACES);
  for (int k = 0; k < places; k++) {
    weight[k] = 2.0 * exp(-0.5 * pow((k + 1) / limit, 2.0));
    steep[k] = weight[k] * pow((k + 1) / limit, 2.0);
    sum += weight[k], sum_steep += steep[k];
  }
  for (int m = 0; m < nodes; m++)
    for (int g = 0; g < GRID; g++) {
      double frequency = 2.0 * PI * g / (2.0 * HALF * grid_step), one_way[2], change[2];
      double x2 = pow(blur * node[m].width_m * frequency, 2.0);
      smooth[m][g] = exp(-0.5 * x2);
      smooth_by_blur[m][g] = -x2 * smooth[m][g];
      for (int side = 0; side < 2; side++) {
        double c = cos(node[m].box_m[side] * frequency), previous = 1.0, now = c, total = 1.0, by_blur = 0.0;
        for (int k = 0; k < places; k++) {
          total += weight[k] * now, by_blur += steep[k] * now;
          double next = 2.0 * c * now - previous;
          previous = now, now = next;
        }
        one_way[side] = total / sum;
        change[side] = (by_blur - one_way[side] * sum_steep) / sum;
      }
      sampled[m][g] = one_way[0] * one_way[1];
      sampled_by_blur[m][g] = change[0] * one_way[1] + one_way[0] * change[1];
    }
}

static double read_grid(double table[MOST_NODES][GRID], const Pixel *p, double share) {
  const double *a = table[p->node] + p->place, *b = table[p->node + 1] + p->place;
  return (1.0 - p->along) * ((1.0 - share) * a[0] + share * a[1]) + p->along * ((1.0 - share) * b[0] + share * b[1]);
}

/* What all pixels see as the unknowns say it. */
static void look(const State *s) {
  static double re[2 * HALF], im[2 * HALF];
  static double largest[MOST_NODES];
  lens(s->blur);
  for (int m = 0; m < nodes; m++) {
    for (int k = 1; k < functions; k++) {
      coefficient[m][k] = 0.0;
      for (int j = 0; j < rank_of[set_of[k]]; j++) coefficient[m][k] += wave[set_of[k]][m][j] * s->z[offset_of[k] + j];
    }
    for (int g = 0; g <= HALF; g++) {
      double sum = transform[m][0][g], frequency = 2.0 * PI * g / (2.0 * HALF * grid_step);
      for (int k = 1; k < functions; k++) sum += coefficient[m][k] * transform[m][k][g];
      double lens_ = smooth[m][g] + s->sharpness * (sampled[m][g] - smooth[m][g]);
      blur_at[m][g] = sum * (smooth_by_blur[m][g] + s->sharpness * (sampled_by_blur[m][g] - smooth_by_blur[m][g]));
      sharp_at[m][g] = sum * (sampled[m][g] - smooth[m][g]);
      /* even for the profile itself, odd for its slope in metres of the grid */
      double slope = g < HALF ? frequency * grid_step : 0.0;
      re[g] = sum * lens_ * (1.0 + slope);
      if (g > 0) re[2 * HALF - g] = sum * lens_ * (1.0 - slope);
    }
    memset(im, 0, sizeof im);
    fft(re, im);
    for (int g = 0; g <= HALF; g++) level_at[m][g] = re[g] / (2.0 * HALF), slope_at[m][g] = im[g] / (2.0 * HALF * grid_step);
    largest[m] = level_at[m][0];
    for (int g = 1; g < GRID; g++) largest[m] = fmax(largest[m], level_at[m][g]);
    cosines(blur_at[m], sharp_at[m], 1.0 / (2.0 * HALF));
  }
  for (int i = 0; i < count; i++) {
    Pixel *p = &near_[i];
    double lift = (1.0 - p->along) * node[p->node].lift_m + p->along * node[p->node + 1].lift_m;
    double y = p->y + product(s->away, p->by_pose, POSE) + lift * (s->blur * s->blur + PIXEL_VARIANCE);
    double at = (y - grid_low) / grid_step;
    p->place = (int)clip(at, 0.0, GRID - 2.0);
    p->share = clip(at - p->place, 0.0, 1.0);
    p->slope = read_grid(slope_at, p, p->share);
    /* between two heights a parabola that their slopes bend: model and derivative are of one piece */
    double bend = 0.5 * grid_step * (read_grid(slope_at, p, 0.0) - read_grid(slope_at, p, 1.0));
    p->level = read_grid(level_at, p, p->share) + p->share * (1.0 - p->share) * bend;
    double shown = s->background + s->gain * p->light * p->level, z = (shown - floor_level) / floor_sigma;
    p->kept = floor_sigma > 0.0 ? normal(z) : 1.0;
    if (floor_sigma > 0.0) shown = floor_level + floor_sigma * (exp(-0.5 * z * z) / sqrt(2.0 * PI) + z * p->kept);
    p->off = p->value - shown;
    p->brightest = p->light * ((1.0 - p->along) * largest[p->node] + p->along * largest[p->node + 1]);
  }
}

/* Chooses the window anew. The air stays as it is: coefficients go over to nodes that lie a little elsewhere, from them
   to the unknowns at the nodes that Cholesky's pivots were. */
static int select_pixels(State *s) {
  static double had[FUNCTIONS][MOST_NODES];
  int had_nodes = nodes;
  memset(had, 0, sizeof had);
  for (int k = 1; k < functions; k++)
    for (int m = 0; m < nodes; m++) had[kind_of[k]][m] = coefficient[m][k];
  if (!choose(s)) return 0;
  functions_of_air();
  memset(s->z, 0, sizeof s->z);
  for (int k = 1; had_nodes && k < functions; k++) {
    double(*W)[MOST_NODES] = wave[set_of[k]], *z = s->z + offset_of[k];
    for (int j = 0; j < rank_of[set_of[k]]; j++) {
      int m = pivot_of[set_of[k]][j];
      double at = (double)m * (had_nodes - 1) / (nodes - 1);
      int i = at < had_nodes - 2 ? (int)at : had_nodes - 2;
      z[j] = (at - i) * had[kind_of[k]][i + 1] + (i + 1 - at) * had[kind_of[k]][i];
      for (int l = 0; l < j; l++) z[j] -= W[m][l] * z[l];
      z[j] /= W[m][j];
    }
  }
  return 1;
}

/* Gain and background that fit best. */
static int levels(State *s) {
  double n = count, x = 0, y = 0, xx = 0, xy = 0;
  look(s);
  for (int i = 0; i < count; i++) {
    double level = near_[i].light * near_[i].level;
    x += level, y += near_[i].value, xx += level * level, xy += level * near_[i].value;
  }
  s->gain = (n * xy - x * y) / (n * xx - x * x);
  s->background = floor_sigma > 0.0 ? floor_space : (y - s->gain * x) / n;
  look(s);
  return s->gain > 0.0;
}

/* Noise */

/* Mean of squared residuals between two levels (of the brightest) that are no outliers by their quartiles. */
static double variance_between(double low, double high, double brightest) {
  double sum = 0.0, number = 0.0, limit;
  int n = 0, all;
  for (int i = 0; i < count; i++) {
    double level = clip(near_[i].light * near_[i].level / brightest, 0.0, 1.0);
    if (level > low && level < high && near_[i].weight > 0.0) scratch[n++] = near_[i].off * near_[i].off;
  }
  all = n <= FEWEST_PIXELS;
  if (all)
    for (n = 0; n < count; n++) scratch[n] = near_[n].off * near_[n].off;
  limit = OUTLIER * OUTLIER * median(scratch, n) / (QUARTILE * QUARTILE);
  for (int i = 0; i < n; i++)
    if (scratch[i] <= limit) sum += scratch[i], number += 1.0;
  return fmax(sum / fmax(number, 1.0), 1e-300);
}

/* The variance that there is at least: what rounding to whole numbers leaves, and bumps that are left out. */
static void least_noise(const State *s) {
  for (int i = 0; i < count; i++) {
    Pixel *p = &near_[i];
    const double *out = &neglected[p->node][p->place];
    p->left = pow(s->gain * p->light * (out[0] + p->share * (out[1] - out[0])), 2.0);
    p->least = 1.0 / 12.0 + p->left;
  }
}

/* The noise of the pixels by the residuals as they are. */
static void estimate_noise(const State *s) {
  static double part[MOST_NEAR][3], expected[MOST_NEAR];
  double brightest = 1e-300, steepest = 1e-300, found[3] = {0.0, 0.0, 0.0};
  for (int i = 0; i < count; i++) {
    const Pixel *p = &near_[i];
    double per_px = s->gain * p->light * p->slope * node[p->node].width_m;
    brightest = fmax(brightest, p->light * p->level);
    part[i][2] = per_px * per_px;
    steepest = fmax(steepest, part[i][2]);
  }
  double dark = variance_between(-1.0, DARK, brightest);
  double bright = variance_between(BRIGHT, 2.0, brightest);
  for (int i = 0; i < count; i++) {
    const Pixel *p = &near_[i];
    double level = clip(p->light * p->level / brightest, 0.0, 1.0);
    part[i][0] = level, part[i][1] = pow(p->below * p->brightest / brightest, 2.0), part[i][2] /= steepest;
    expected[i] = fmax(dark + fmax(bright - dark, 0.0) * level, p->least);
  }
  for (int round = 0; round < WEIGHINGS; round++) {
    double A[3][3] = {{0}}, b[3] = {0}, size[3], x[3];
    for (int i = 0; i < count; i++) {
      double square = near_[i].off * near_[i].off;
      if (square >= OUTLIER * OUTLIER * expected[i]) continue;
      for (int j = 0; j < 3; j++) {
        b[j] += part[i][j] * (square - dark) / pow(expected[i], 2.0);
        for (int k = 0; k < 3; k++) A[j][k] += part[i][j] * part[i][k] / pow(expected[i], 2.0);
      }
    }
    for (int j = 0; j < 3; j++) size[j] = sqrt(fmax(A[j][j], 1e-300));
    for (int j = 0; j < 3; j++) {
      b[j] /= size[j];
      for (int k = 0; k < 3; k++) A[j][k] = A[j][k] / (size[j] * size[k]) + (j == k ? 1e-9 : 0.0);
    }
    not_negative(A, b, x);
    for (int j = 0; j < 3; j++) found[j] = x[j] / size[j];
    for (int i = 0; i < count; i++) expected[i] = fmax(dark + product(found, part[i], 3), near_[i].least);
  }
  for (int i = 0; i < count; i++) {
    Pixel *p = &near_[i];
    p->variance = expected[i];
    p->shown = fmin(product(found, part[i], 3) / expected[i], 1.0);
    p->by_level = expected[i] <= p->least ? 0.0 : found[0] / brightest;
  }
}

/* The weights of pixels that are chosen again; those that are new are as good as the median one. With noise that began
   anew the pose left its place, for which the pixels were chosen again, and so on until the steps were used up. */
static float kept_weight[MOST_PIXELS];
static void keep_weights(void) {
  int n = 0;
  for (int i = 0; i < count; i++)
    if (near_[i].weight > 0.0) scratch[n++] = near_[i].weight;
  double usual = n > 0 ? median(scratch, n) : 1.0;
  for (int i = 0; i < width * height; i++) kept_weight[i] = (float)usual;
  for (int i = 0; i < count; i++) kept_weight[near_[i].row * width + near_[i].column] = (float)near_[i].weight;
}
static void take_weights_over(void) {
  for (int i = 0; i < count; i++) near_[i].weight = kept_weight[near_[i].row * width + near_[i].column];
}

/* How much larger the variance of the residuals' sums over squares is than of independent ones. */
static double alike(void) {
  static double sum[MOST_SQUARES], number[MOST_SQUARES];
  double most = 1.0;
  for (int side = 4; side <= 32; side *= 2) {
    int in_row = (width - 1) / side + 1, squares = in_row * ((height - 1) / side + 1);
    double total = 0.0, pixels = 0.0;
    for (int i = 0; i < squares; i++) sum[i] = number[i] = 0.0;
    for (int i = 0; i < count; i++) {
      int square = near_[i].row / side * in_row + near_[i].column / side;
      sum[square] += sqrt(near_[i].weight) * near_[i].off;
      number[square] += near_[i].weight > 0.0;
    }
    for (int i = 0; i < squares; i++)
      if (number[i] > side) total += sum[i] * sum[i], pixels += number[i];
    most = fmax(most, total / fmax(pixels, 1.0));
  }
  return most;
}

/* How many pixels count as one. What the residuals show beyond the noise of dark pixels is as alike as their sums
   over squares say, what is left out of the air over a bump's height and length. */
static void widen(void) {
  double beyond = alike(), shown = 0.0, used = 0.0;
  for (int i = 0; i < count; i++)
    if (near_[i].weight > 0.0) shown += near_[i].shown, used += 1.0;
  double more = (beyond - 1.0) * clip((beyond - LEAST_ALIKE) / (SURELY_ALIKE - LEAST_ALIKE), 0.0, 1.0);
  more /= fmax(shown / fmax(used, 1.0), 1e-300);
  for (int i = 0; i < count; i++) {
    Pixel *p = &near_[i];
    double of_left = fmax(BUMP_M * LEFT_LENGTH * EARTH_M / pow(node[p->node].width_m, 2.0), 1.0) - 1.0;
    p->wider = first_part ? 1.0 : 1.0 + more * p->shown + of_left * fmin(p->left / p->variance, 1.0);
  }
}

/* Weighs the pixels by their noise; returns by how much the weights' logarithms changed (rms). */
static double weigh(const State *s) {
  static double before[MOST_NEAR];
  double changed = 0.0, both = 0.0;
  least_noise(s);
  estimate_noise(s);
  for (int i = 0; i < count; i++) {
    Pixel *p = &near_[i];
    double square = p->off * p->off / p->variance;
    before[i] = p->weight;
    p->weight = square < OUTLIER * OUTLIER ? 1.0 / p->variance : 0.0;
    p->pull = first_part ? 0.0 : 0.5 * (fmin(square, OUTLIER * OUTLIER) - 1.0) * p->by_level / s->gain;
  }
  widen();
  for (int i = 0; i < count; i++) {
    double weight = near_[i].weight /= near_[i].wider;
    if (weight > 0.0 && before[i] > 0.0) changed += pow(log(weight / before[i]), 2.0), both += 1.0;
  }
  return sqrt(changed / fmax(both, 1.0));
}

/* Equations */

/* The step to the priors' values, and their information; shared unknowns. */
static void priors(const State *s, double *wanted, double *information) {
  turn_between(prior.R[0], s->R[0], wanted + TURN);
  for (int i = 0; i < 3; i++) {
    wanted[TURN + i] -= s->away[i], wanted[POSITION + i] = prior.r[i] - s->r[i] - s->away[3 + i];
    information[TURN + i] = 1.0 / (sigma_q * sigma_q), information[POSITION + i] = 1.0 / (sigma_r * sigma_r);
  }
  wanted[LIFT] = -s->lift - s->away[6], information[LIFT] = 1.0 / (lift_sigma * lift_sigma);
  wanted[BLUR] = log(prior.blur / s->blur), information[BLUR] = 1.0 / (blur_sigma * blur_sigma);
  wanted[SHARPNESS] = prior.sharpness - s->sharpness, information[SHARPNESS] = 1.0 / (SHARPNESS_SIGMA * SHARPNESS_SIGMA);
  wanted[GAIN] = gain_sigma > 0.0 ? log(prior.gain / s->gain) : 0.0;
  information[GAIN] = gain_sigma > 0.0 ? 1.0 / (gain_sigma * gain_sigma) : 0.0;
  wanted[BACKGROUND] = floor_space - s->background;
  information[BACKGROUND] = floor_sigma > 0.0 ? 1.0 / (floor_sigma * floor_sigma) : 0.0;
}

/* What the most probable unknowns make smallest: with the noise that fits the residuals. */
static double merit_of(const State *s) {
  double wanted[SHARED], information[SHARED], sum = 0.0;
  if (!first_part) estimate_noise(s);
  priors(s, wanted, information);
  for (int i = 0; i < SHARED; i++) sum += information[i] * wanted[i] * wanted[i];
  for (int i = 0; i < air; i++) sum += s->z[i] * s->z[i];
  for (int i = 0; i < count; i++) {
    const Pixel *p = &near_[i];
    if (first_part)
      sum += p->weight * p->off * p->off;
    else
      sum += (fmin(p->off * p->off / p->variance, OUTLIER * OUTLIER) + log(p->variance)) / p->wider;
  }
  return sum;
}

/* L L^T = N, lower triangles. */
static int cholesky(void) {
  for (int i = 0; i < unknowns; i++)
    for (int j = 0; j <= i; j++) {
      double v = N[i][j] - product(L[i], L[j], j);
      if (j < i) {
        L[i][j] = v / L[j][j];
      } else {
        if (!(v > 0.0)) return 0;
        L[i][i] = sqrt(v);
      }
    }
  return 1;
}

/* N x = x */
static void solve(double *x) {
  for (int i = 0; i < unknowns; i++) x[i] = (x[i] - product(L[i], x, i)) / L[i][i];
  for (int i = unknowns - 1; i >= 0; i--) {
    x[i] /= L[i][i];
    for (int k = 0; k < i; k++) x[k] -= L[i][k] * x[i];
  }
}

/* All functions as the lens blurs them. */
static void tabulate(const State *s) {
  static double a[GRID], b[GRID];
  for (int m = 0; m < nodes; m++)
    for (int k = 1; k < functions; k += 2) {
      int other = k + 1 < functions ? k + 1 : k;
      for (int g = 0; g < GRID; g++) {
        double lens_ = smooth[m][g] + s->sharpness * (sampled[m][g] - smooth[m][g]);
        a[g] = lens_ * transform[m][k][g], b[g] = lens_ * transform[m][other][g];
      }
      cosines(a, b, 1.0 / (2.0 * HALF));
      for (int g = 0; g < GRID; g++) value_at[m][g][k] = a[g], value_at[m][g][other] = b[g];
    }
}

/* Normal equations at the present state. Those of the coefficients at a node, and at a node and the next, first: a pixel
   lies between two nodes. Then those of the unknowns that the coefficients come of. */
static int equations(const State *s) {
  static double own[MOST_NODES][FUNCTIONS][FUNCTIONS], next[MOST_NODES][FUNCTIONS][FUNCTIONS];
  static double to_shared[MOST_NODES][FUNCTIONS][SHARED], pull[MOST_NODES][FUNCTIONS];
  static double pushed[MOST_NODES][MOST_NODES];
  double wanted[SHARED], information[SHARED], shared[SHARED][SHARED] = {{0}}, shared_pull[SHARED] = {0};
  memset(own, 0, sizeof own), memset(next, 0, sizeof next);
  memset(to_shared, 0, sizeof to_shared), memset(pull, 0, sizeof pull);
  tabulate(s);
  for (int i = 0; i < count; i++) {
    const Pixel *p = &near_[i];
    if (p->weight == 0.0) continue;
    const Node *a = &node[p->node], *b = a + 1;
    double amplitude = s->gain * p->light * p->kept, J[SHARED], row[2][FUNCTIONS];
    double lifted = 2.0 * s->blur * s->blur * ((1.0 - p->along) * a->lift_m + p->along * b->lift_m);
    J[BLUR] = amplitude * (read_grid(blur_at, p, p->share) + p->slope * lifted);
    J[SHARPNESS] = amplitude * read_grid(sharp_at, p, p->share);
    J[GAIN] = amplitude * p->level;
    J[BACKGROUND] = p->kept;
    for (int c = 0; c < POSE; c++) J[TURN + c] = amplitude * p->slope * p->by_pose[c];
    for (int e = 0; e < 2; e++) {
      double along = amplitude * (e ? p->along : 1.0 - p->along), low = along * (1.0 - p->share), high = along * p->share;
      const float *v = value_at[p->node + e][p->place], *w = value_at[p->node + e][p->place + 1];
      for (int k = 1; k < functions; k++) row[e][k] = low * v[k] + high * w[k];
    }
    for (int j = 0; j < SHARED; j++) {
      double weighted = p->weight * J[j];
      /* gain and background do without: with them the noise changes as a whole */
      shared_pull[j] += weighted * (p->off + (j == GAIN || j == BACKGROUND ? 0.0 : p->pull));
      for (int k = 0; k <= j; k++) shared[j][k] += weighted * J[k];
      for (int e = 0; e < 2; e++)
        for (int k = 1; k < functions; k++) to_shared[p->node + e][k][j] += weighted * row[e][k];
    }
    for (int j = 1; j < functions; j++) {
      double here = p->weight * row[0][j], there = p->weight * row[1][j];
      double *x = own[p->node][j], *y = own[p->node + 1][j], *z = next[p->node][j];
      pull[p->node][j] += here * (p->off + p->pull), pull[p->node + 1][j] += there * (p->off + p->pull);
      for (int k = 1; k <= j; k++) x[k] += here * row[0][k], y[k] += there * row[1][k];
      for (int k = 1; k < functions; k++) z[k] += here * row[1][k];
    }
  }
  for (int j = 1; j < functions; j++) {
    double(*W)[MOST_NODES] = wave[set_of[j]];
    int rank = rank_of[set_of[j]], first = offset_of[j];
    for (int a = 0; a < rank; a++) {
      right_[first + a] = -s->z[first + a];
      for (int c = 0; c < SHARED; c++) N[air + c][first + a] = 0.0;
      for (int m = 0; m < nodes; m++) {
        right_[first + a] += W[m][a] * pull[m][j];
        for (int c = 0; c < SHARED; c++) N[air + c][first + a] += W[m][a] * to_shared[m][j][c];
      }
    }
    for (int k = 1; k <= j; k++) {
      double(*V)[MOST_NODES] = wave[set_of[k]];
      int other = rank_of[set_of[k]];
      for (int m = 0; m < nodes; m++)
        for (int b = 0; b < other; b++)
          pushed[m][b] = own[m][j][k] * V[m][b] + (m + 1 < nodes ? next[m][j][k] * V[m + 1][b] : 0.0) +
                         (m > 0 ? next[m - 1][k][j] * V[m - 1][b] : 0.0);
      for (int a = 0; a < rank; a++) {
        double *out = N[first + a] + offset_of[k];
        for (int b = 0; b < other; b++) out[b] = j == k && a == b;
        for (int m = 0; m < nodes; m++)
          for (int b = 0; b < other; b++) out[b] += W[m][a] * pushed[m][b];
      }
    }
  }
  priors(s, wanted, information);
  if (first_part) information[BLUR] *= HELD, information[SHARPNESS] *= HELD;
  for (int j = 0; j < SHARED; j++) {
    for (int k = 0; k <= j; k++) N[air + j][air + k] = shared[j][k] + (j == k ? information[j] : 0.0);
    right_[air + j] = shared_pull[j] + information[j] * wanted[j];
  }
  return cholesky();
}

/* Variance of the lens along one axis, and its change by the blur's logarithm and the sharpness. */
static double lens_variance(double blur, double sharpness, double *by_log, double *by_sharpness) {
  double limit = fmax(blur, 0.15), whole = 1.0, second = 0.0, fourth = 0.0;
  for (int k = 1; k <= (int)ceil(5.0 * limit); k++) {
    double weight = 2.0 * exp(-0.5 * k * k / (limit * limit));
    whole += weight, second += weight * k * k, fourth += weight * pow(k, 4.0);
  }
  double sampled_ = second / whole, smooth_ = blur * blur;
  *by_log = (1.0 - sharpness) * 2.0 * smooth_ + sharpness * (fourth / whole - sampled_ * sampled_) / (limit * limit);
  *by_sharpness = sampled_ - smooth_;
  return (1.0 - sharpness) * smooth_ + sharpness * sampled_;
}

/* The blur after a step. Blur and sharpness turn along a bent valley: the lens's variance goes as far as their
   derivatives say, the sharpness as it is told, and the blur follows (Newton). */
static double blur_after(const State *s, double log_step, double sharpness_step) {
  double plain = s->blur * exp(log_step), blur = plain, by_log, by_sharpness;
  double variance = lens_variance(s->blur, s->sharpness, &by_log, &by_sharpness);
  if (!(variance > 0.0 && by_log > 0.0)) return plain;
  double wanted = log(variance) + (by_log * log_step + by_sharpness * sharpness_step) / variance;
  for (int round = 0; round < MOST_ROUNDS; round++) {
    variance = lens_variance(blur, s->sharpness + sharpness_step, &by_log, &by_sharpness);
    if (!(variance > 0.0 && by_log > 0.0)) return plain;
    double off = (wanted - log(variance)) * variance / by_log;
    blur *= exp(clip(off, -MOST_ROUND, MOST_ROUND));
    if (fabs(off) < ROUNDED) return blur;
  }
  return plain;
}

static void move(State *s, const double *step, double scale) {
  const double *own = step + air;
  double brighter = fmax(1.0 + scale * own[GAIN], LEAST_GAIN);
  for (int i = 0; i < POSE; i++) s->away[i] += scale * own[TURN + i];
  s->blur = blur_after(s, scale * own[BLUR], scale * own[SHARPNESS]);
  s->sharpness += scale * own[SHARPNESS];
  /* brightness is a product of gain and air: taken like this, it moves as the derivatives say, however far */
  s->gain *= brighter;
  s->background += scale * own[BACKGROUND];
  for (int i = 0; i < air; i++) s->z[i] += scale * step[i] / brighter;
}

/* By how many pixels a way, or a step, moves the limb at most. */
static double motion_px_of(const double *away) {
  double most = 0.0;
  for (int i = 0; i < count; i++) most = fmax(most, fabs(product(away, near_[i].by_pose, POSE)));
  return most / median_width;
}
static double motion_px(const double *step) { return motion_px_of(step + air + TURN); }

/* The square of a step of the pose over its own covariance: Cholesky's last rows. */
static double size_of(const double *step) {
  double size = 0.0;
  for (int j = 0; j < POSE; j++) {
    double sum = 0.0;
    for (int i = j; i < POSE; i++) sum += L[unknowns - POSE + i][unknowns - POSE + j] * step[unknowns - POSE + i];
    size += sum * sum;
  }
  return size;
}

/* Goes as far along a step as the pixels become more probable; 0 for no way. Where less than half of the merit is gained
   that the step promised, as in a bent valley, the parabola through what is known of the way says how far to go. */
static int search_along(State *s, const double *step, double promised) {
  static State origin, found;
  double merit_before = merit_of(s), best = INFINITY, share = 1.0;
  origin = *s;
  for (int trial = 0; trial < MOST_TRIALS; trial++) {
    *s = origin;
    move(s, step, share);
    look(s);
    double merit = merit_of(s);
    if (merit < best && merit <= merit_before + ROUNDING) best = merit, found = *s;
    else if (best < INFINITY) break;
    if (merit_before - merit >= 0.5 * promised * share * (2.0 - share) - ROUNDING) break;
    double bend = (merit - merit_before + 2.0 * promised * share) / (share * share);
    share = clip(promised / bend, LEAST_SHARE * share, MOST_SHARE * share);
  }
  *s = best < INFINITY ? found : origin;
  look(s);
  return merit_before - best > WORTH;
}

/* The most probable state near a start; returns the steps it took, 0 without an answer, and says why. */
static int search(State *s, const char **reason) {
  static double step[MOST_UNKNOWNS];
  int settled = 0, round = 0;
  double size = INFINITY;
  *reason = "too little limb in view, or more pixels of it than this program holds";
  first_part = 1;
  if (!select_pixels(s)) return 0;
  *reason = "the image is not brighter where the limb should be";
  if (!levels(s)) return 0;
  weigh(s);
  *reason = "the limb in view does not determine the fit's unknowns";
  while (round++ < MOST_STEPS) {
    if (!equations(s)) return 0;
    memcpy(step, right_, sizeof(double) * unknowns);
    solve(step);
    double promised = product(step, right_, unknowns), most_px = fmax(LARGEST_M / median_width, LARGEST_PX);
    double over = fmax(motion_px(step) / most_px, fmax(fabs(step[air + BLUR]), fabs(step[air + GAIN])) / LARGEST_LOG);
    for (int i = 0; over > 1.0 && i < unknowns; i++) step[i] /= over;
    promised /= fmax(over * over, 1.0);
    size = size_of(step);
    int held = settled >= SETTLING_STEPS;
    if (held && size < CONVERGED && promised < 1.0) {
      move(s, step, 1.0);
      look(s);
      return round;
    }
    int improved = search_along(s, step, promised);
    if (held && !improved) return round;
    if (held) continue;
    int close = size < (first_part ? NEARLY_SETTLED : SETTLED) || !improved;
    double away_px = motion_px_of(s->away);
    if ((close && first_part) || away_px > (close ? CLOSE_PX : RESELECT_PX)) {
      keep_weights();
      if (!select_pixels(s)) return 0;
      take_weights_over();
      look(s);
      first_part = first_part && !close;
    }
    double changed = weigh(s);
    settled = close && changed < STEADY ? settled + 1 : 0;
  }
  *reason = "no convergence";
  if (size > 1.0) return 0;
  /* the claim is that of the noise as it is now */
  return equations(s) ? MOST_STEPS : 0;
}

/* How many of the air's unknowns the pixels determine, the trace of 1 - C: the sum of their squares is as many in the mean. */
static double determined_air(void) {
  static double column[MOST_UNKNOWNS];
  double determined = air;
  for (int j = 0; j < air; j++)
    for (int i = j; i < unknowns; i++) {
      column[i] = ((i == j) - product(L[i] + j, column + j, i - j)) / L[i][i];
      determined -= column[i] * column[i];
    }
  return determined;
}

/* Share of the pixels' variance that the prediction explains, outliers apart. */
static double explained(void) {
  double used = 0.0, mean = 0.0, off = 0.0, whole = 0.0;
  for (int i = 0; i < count; i++)
    if (near_[i].weight > 0.0) used += 1.0, mean += near_[i].value;
  mean /= used;
  for (int i = 0; i < count; i++)
    if (near_[i].weight > 0.0) off += pow(near_[i].off, 2.0), whole += pow(near_[i].value - mean, 2.0);
  return 1.0 - off / whole;
}

/* The start */

/* The tilt near the prior's attitude at which the predicted picture is most like a coarse copy of the image. */
static int start(State *s) {
  enum { MOST_COARSE = 64 * 64, AZIMUTHS = 24, MOST_GRID = 1024, STEPS = 14, FINER_STEPS = 4, COARSE_PX = 56 };
  static double value[MOST_COARSE], radius[MOST_COARSE], light[MOST_COARSE], u[MOST_COARSE][3];
  static double profile[AZIMUTHS][MOST_GRID], blurred[AZIMUTHS][MOST_GRID];
  static int bin[MOST_COARSE];
  static Node at;
  double nadir[3], a[3], b[3], distance = sqrt(dot(s->r, s->r)), to_limb = sqrt(distance * distance - A_M * A_M);
  double fine = 1e3, best[2] = {0, 0}, score = -INFINITY, mean = 0.0, power = 0.0, spare, n_[3];
  int n = 0, factor = ((width > height ? width : height) + COARSE_PX - 1) / COARSE_PX;
  nadir_of(s, nadir);
  basis(nadir, a, b);
  for (int row = 0; row + factor <= height; row += factor)
    for (int column = 0; column + factor <= width; column += factor, n++) {
      sight(column + (factor - 1) / 2, row + (factor - 1) / 2, u[n]);
      value[n] = 0.0;
      for (int i = 0; i < factor; i++)
        for (int j = 0; j < factor; j++) value[n] += image[(row + i) * width + column + j] / (double)(factor * factor);
      light[n] = pow(u[n][2], 4.0);
      double down = dot(nadir, u[n]), h = lowest(s, u[n], &spare, n_);
      /* the Earth's radius there, as the ellipsoid has it; beyond a right angle from the nadir there is only space */
      radius[n] = down > 0.0 ? distance * sqrt(fmax(1.0 - down * down, 0.0)) - h : 0.0;
      int i = (int)floor(atan2(dot(b, u[n]), dot(a, u[n])) * AZIMUTHS / (2.0 * PI) + 0.5);
      bin[n] = (i + AZIMUTHS) % AZIMUTHS;
      mean += value[n];
    }
  mean /= n;
  for (int i = 0; i < n; i++) value[i] -= mean, power += value[i] * value[i];
  double low = limb_height_m[0], high = limb_height_m[LIMB_H - 1] + 60e3;
  int size = (int)ceil((high - low) / fine);
  if (size > MOST_GRID) size = MOST_GRID, fine = (high - low) / size;
  double cosine = to_limb / distance, sine = sqrt(1.0 - cosine * cosine);
  for (int k = 0; k < AZIMUTHS; k++) {
    double angle = 2.0 * PI * k / AZIMUTHS, los[3];
    for (int i = 0; i < 3; i++) los[i] = sine * (cos(angle) * a[i] + sin(angle) * b[i]) + cosine * nadir[i];
    look_up(s, los, &at);
    for (int g = 0; g < size; g++) {
      double share, h = low + g * fine;
      int i = before(limb_height_m, LIMB_H, h, &share);
      profile[k][g] = h > limb_height_m[LIMB_H - 1] ? 0.0 : (1.0 - share) * at.mean[i] + share * at.mean[i + 1];
    }
  }
  double step = 3.5 * sigma_q / STEPS, pixel_rad = factor / fmax(fx, fy), finest = fmax(FINEST_M / to_limb, FINEST_PX * pixel_rad);
  for (int reach = STEPS;; reach = FINER_STEPS, step /= 3.0) {
    double sigma = fmax(step, pixel_rad) * to_limb * 0.5 / fine, middle[2] = {best[0], best[1]};
    int taps = (int)fmin(4.0 * sigma + 0.5, MOST_GRID);
    for (int k = 0; k < AZIMUTHS; k++)
      for (int g = 0; g < size; g++) {
        double sum = 0.0, weights = 0.0;
        for (int t = -taps; t <= taps; t += 1 + taps / 40) {
          double w = exp(-0.5 * t * t / (sigma * sigma));
          sum += w * profile[k][(int)clip(g + t, 0, size - 1)], weights += w;
        }
        blurred[k][g] = sum / weights;
      }
    for (int i = -reach; i <= reach; i++)
      for (int j = -reach; j <= reach; j++) {
        double tilt[2] = {middle[0] + i * step, middle[1] + j * step}, down[3], x = 0.0, xx = 0.0, xy = 0.0;
        for (int c = 0; c < 3; c++) down[c] = nadir[c] + tilt[0] * a[c] + tilt[1] * b[c];
        unit(down);
        for (int p = 0; p < n; p++) {
          double c = dot(down, u[p]);
          if (c <= 0.0) continue;
          int g = (int)clip((distance * sqrt(fmax(1.0 - c * c, 0.0)) - radius[p] - low) / fine, 0.0, size - 1.0);
          double level = light[p] * blurred[bin[p]][g];
          x += level, xx += level * level, xy += level * value[p];
        }
        double like = -(tilt[0] * tilt[0] + tilt[1] * tilt[1]) / (sigma_q * sigma_q);
        if (xy > 0.0) like -= n * log(fmax(1.0 - xy * xy / fmax((xx - x * x / n) * power, 1e-300), 1e-12));
        if (like > score || (i == -reach && j == -reach)) score = like, best[0] = tilt[0], best[1] = tilt[1];
      }
    if (step <= finest) break;
  }
  if (!(score > 0.0)) return 0;
  double down[3], w[3];
  for (int c = 0; c < 3; c++) down[c] = nadir[c] + best[0] * a[c] + best[1] * b[c];
  unit(down);
  cross(nadir, down, w);
  double length = sqrt(dot(w, w));
  for (int c = 0; length > 0.0 && c < 3; c++) w[c] *= asin(length) / length;
  turn(s->R, w);
  return 1;
}

/* The answer */

static int refuse(const char *status, const char *reason) {
  printf("{\"status\": \"%s\", \"reason\": \"%s\"}\n", status, reason);
  return 0;
}

/* By how much the air's unknowns scatter more than they should, 1 where chance may do so. */
static double strain(const State *s) {
  double squares = product(s->z, s->z, air), determined = determined_air();
  return squares > determined + SCATTERED * sqrt(2.0 * determined) ? squares / determined : 1.0;
}

/* The variance of a change g of the pose if the air were known: of the shared unknowns' own equations (Cholesky). */
static double known_variance(const double *g) {
  double C[SHARED][SHARED], x[SHARED], variance = 0.0;
  for (int i = 0; i < SHARED; i++) {
    for (int j = 0; j <= i; j++) {
      C[i][j] = N[air + i][air + j] - product(C[i], C[j], j);
      C[i][j] = i == j ? sqrt(C[i][i]) : C[i][j] / C[j][j];
    }
    x[i] = ((i < TURN ? 0.0 : g[i - TURN]) - product(C[i], x, i)) / C[i][i];
    variance += x[i] * x[i];
  }
  return variance;
}

/* Mean square of the nadir's error: by the turn w it moves by w x nadir, by the position by -R (across r) / |r|. Air that
   strains what is known of it makes its part of that larger. */
static double nadir_variance(const State *s, const double *nadir) {
  static double f[MOST_UNKNOWNS];
  double variance = 0.0, r2 = dot(s->r, s->r), strained = strain(s);
  for (int c = 0; c < 3; c++) {
    double e[3] = {0, 0, 0}, g[POSE] = {0}, arm[3], down[3];
    e[c] = 1.0;
    cross(nadir, e, arm);
    times_transposed(s->R[0], e, down);
    double radial = dot(down, s->r) / r2;
    for (int i = 0; i < 3; i++) g[i] = arm[i], g[3 + i] = -(down[i] - radial * s->r[i]) / sqrt(r2);
    memset(f, 0, sizeof f);
    memcpy(f + air + TURN, g, sizeof g);
    solve(f);
    double known = known_variance(g), whole = product(g, f + air + TURN, POSE);
    variance += known + strained * (whole - known);
  }
  return variance;
}

/* The largest coefficient of any function in its own standard deviations. */
static double improbable(void) {
  double most = 0.0;
  for (int k = 1; k < functions; k++)
    for (int m = 0; m < nodes; m++)
      most = fmax(most, fabs(coefficient[m][k]) / (set_of[k] == LIMB_K + 1 ? AIR_GAIN_SIGMA : 1.0));
  return most;
}

int main(void) {
  static State s;
  double q[4], nadir[3], w[3];
  const char *reason;
  if (scanf("%d %d %lf %lf %lf %lf", &width, &height, &fx, &fy, &cx, &cy) != 6 ||
      scanf("%lf %lf %lf %lf", &s.r[0], &s.r[1], &s.r[2], &sigma_r) != 4 ||
      scanf("%lf %lf %lf %lf %lf", &q[0], &q[1], &q[2], &q[3], &sigma_q) != 5 ||
      scanf("%lf %lf %lf %lf", &month, &sun_read[0], &sun_read[1], &sun_read[2]) != 4 ||
      scanf("%lf %lf %lf", &sun_known[0], &sun_known[1], &sun_known[2]) != 3 ||
      scanf("%lf %lf %lf %lf %lf", &s.blur, &blur_sigma, &lift_sigma, &s.gain, &gain_sigma) != 5 ||
      scanf("%lf", &full_scale) != 1 || getchar() != '\n' ||
      width < 8 || height < 8 || width > MOST_SIDE || height > MOST_SIDE || (long)width * height > MOST_PIXELS ||
      fread(image, sizeof *image, (size_t)width * height, stdin) != (size_t)width * height)
    return refuse("bad_input", "the image or what is known beside it cannot be read");
  double numbers = cx + cy + dot(s.r, s.r) + dot(q, q) + q[3] + month + dot(sun_read, sun_read) + dot(sun_known, sun_known);
  double above_0[] = {fx, fy, sigma_r, sigma_q, s.blur, blur_sigma, lift_sigma};
  for (size_t i = 0; i < sizeof above_0 / sizeof *above_0; i++)
    if (!(above_0[i] > 0.0 && isfinite(above_0[i])))
      return refuse("bad_input", "focal lengths, blur and sigmas must be above 0");
  if (!isfinite(numbers + full_scale) || !isfinite(gain_sigma) || (gain_sigma > 0.0 && !(s.gain > 0.0 && isfinite(s.gain))))
    return refuse("bad_input", "a number beside the image is not finite, or the gain not above 0");
  prepare_splines();
  from_quaternion(q, s.R);
  if (dot(s.r, s.r) < A_M * A_M * 1.0001) return refuse("bad_input", "the position lies in the Earth");
  s.sharpness = SHARPNESS_PRIOR;
  prior = s;
  if (!start(&s)) return refuse("no_limb", "no tilt near the prior's makes the image like a limb");
  int steps = search(&s, &reason);
  rest(&s);
  if (!steps) return refuse("no_limb", reason);
  if (!(explained() > LEAST_EXPLAINED)) return refuse("no_limb", "the predicted limb explains too little of the image");
  if (improbable() > MOST_IMPROBABLE) return refuse("ambiguous", "the air would be far from what its table knows");
  turn_between(s.R[0], prior.R[0], w);
  for (int i = 0; i < 3; i++)
    if (fabs(w[i]) > MOST_SIGMA * sigma_q) return refuse("ambiguous", "the limb lies far from the prior's attitude");
  nadir_of(&s, nadir);
  to_quaternion(s.R, q);
  printf("{\"status\": \"valid\", \"nadir_cam\": [%.12f, %.12f, %.12f], \"sigma_nadir_arcsec\": %.4f, ", nadir[0], nadir[1],
         nadir[2], sqrt(nadir_variance(&s, nadir)) * 180.0 / PI * 3600.0);
  printf("\"q_cam_from_itrs\": [%.12f, %.12f, %.12f, %.12f], ", q[0], q[1], q[2], q[3]);
  printf("\"position_itrs_km\": [%.6f, %.6f, %.6f], \"lift_m\": %.3f, ", s.r[0] / 1e3, s.r[1] / 1e3, s.r[2] / 1e3, s.lift);
  printf("\"reason\": \"%d steps, %d pixels, %d nodes, %d unknowns\"}\n", steps, count, nodes, unknowns);
  return 0;
}
