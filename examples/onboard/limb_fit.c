/* The tilt of a camera from one image of the limb, by rendered profiles: a reference for a flight computer. C99, no
   allocation, no library but libm. The program reads table.h of `horizonval templates` and has the model, the priors
   and the noise of the estimator `limb-profile` of horizonval, so that one can be tested against the other.

   A pixel whose line of sight passes at the height h over the ellipsoid (below 0: how deep it would come), between two
   nodes along the limb, is

       I = background + gain * light * P_s(y(h - lift) + c (s^2 + 1/12)) + noise,     P = mean + sum of a_k f_k

   P_s is the profile at the nodes, linear between them, as the pixel's two sides and a lens of s pixels blur it, and
   light the cosine of the off-axis angle to the fourth. y is the distance across the limb in which pixels are even,
   h = y - curve y^2, and c (s^2 + 1/12) the shift of a bent limb by blur. The functions f_k are the table's modes,
   once more where lines end in other air, bumps over height for what the modes leave out, and the mean itself for a
   gain that varies along the limb. Unknown are turn (3), position (3), lift, ln blur, sharpness of the lens, ln gain,
   background, and unit unknowns z behind the coefficients at the nodes, a_k = W_k z, with W W^T their covariance
   exp(-d^2 / 2 l^2) for nodes a distance d apart at the Earth's centre.

   The program minimises, with priors as rows of the same equations,

       sum (nu + 1) ln(1 + r^2 / (nu v)) / together + priors,       (J^T W J + Q) step = J^T W r + Q (prior - now)

   Residuals r follow Student's distribution, W = (nu + 1) / (nu + r^2 / v) / (v together). The variance v is that of
   dark pixels plus components fitted to the squared residuals (level, clouds, slope), and not less than rounding and
   neglected air make. Where residuals are correlated, several pixels count together as one. Where the converter cuts
   noise off at its lowest level, the prediction is the mean of what is left. The lens is held near its prior in the
   first of two stages. The derivatives J are computed again only where a step gains less than they predict, and at the
   end; until then a step costs one prediction and one product. Above MOST_ROWS pixels, means of pixels of nearly one
   height count as one.

   J has few entries in a row: the functions at the two nodes of the pixel, and the shared unknowns. Their products are
   summed at the nodes, of which only neighbours couple; the sums for the unknowns z follow from these.

   Not in this program: lenses with distortion, stated diffraction and blur over the field, foreign light outside the
   limb, a lens that is softer at one part of the limb, planets that are spheres, sigmas of the attitude by axis. A
   saturated pixel is known by full_scale alone. MOST_NODES is half of the most that `limb-profile` has, which matters
   only where more than 1.1 rad of limb at the Earth's centre are in view.

   Standard input: one line of 28 numbers, and then width * height values of 16 bits in the machine's order, row by row:
     width height fx fy cx cy                  pixels
     rx ry rz  sigma_position                  m, Earth-fixed axes
     qx qy qz qw  sigma_attitude               from Earth-fixed to camera axes; rad, about any axis
     month                                     1.0 in the middle of January
     sx sy sz                                  towards the Sun as a sensor reads it, or as time and attitude say it;
                                               camera axes, unit vector
     tx ty tz                                  towards the Sun as the time says it, Earth-fixed axes; 0 0 0: unknown
     blur  blur_log_sigma  lift_sigma          px of the lens, m
     gain  gain_log_sigma                      values per radiance of the table on the axis; sigma 0 without calibration
     full_scale                                value of a saturated pixel; 0: none is
   Standard output: one JSON object, as docs/howto/estimator-program.md says, with the additional keys q_cam_from_itrs,
   position_itrs_km and lift_m. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "maths.h"
#include "table.h"

#define MOST_PIXELS (2048 * 2048)
#define MOST_NEAR 400000
#define MOST_SIDE 32767
#define MOST_SQUARES (MOST_PIXELS / 16 + MOST_SIDE / 2 + 1) /* of 4 pixels a side, in an image of any shape */
#define MOST_ROWS 6000
#define ROWS (MOST_ROWS + 2048) /* groups at the ends of pieces of the limb are not full */
#define MOST_NODES 33
#define BUMPS 15
#define FUNCTIONS (1 + 2 * LIMB_K + BUMPS + 1)
#define SETS (LIMB_K + 2)
#define MOST_UNKNOWNS (SHARED + MOST_NODES * (FUNCTIONS - 1))
#define ROW (2 * (FUNCTIONS - 1) + SHARED + WIDE)

/* Shared unknowns; the pose comes last, so that the last rows of Cholesky's triangle are its information. */
enum { BLUR, SHARPNESS, GAIN, BACKGROUND, TURN, POSITION = TURN + 3, LIFT = POSITION + 3, SHARED };
enum { POSE = SHARED - TURN };
/* Tables of a node over the grid of heights. */
enum { LEVEL, SLOPE, BY_BLUR, BY_SHARPNESS, TABLES };

static const double A_M = 6378137.0, EARTH_M = 6.371e6, PIXEL_VARIANCE = 1.0 / 12.0;
static const double SHARPNESS_PRIOR = 0.5, SHARPNESS_SIGMA = 0.5;
/* Window of heights, and grid beyond it. */
static const double DEPTH_PX = 0.5, TAPER_PX = 0.5, LEAST_TAPER = 1e-3, SPACE_PX = 4.0, EDGE_BLURS = 2.5;
static const double GRID_RIMS = 2.0, ABOVE_RIMS = 0.3, STEPS_PER_PIXEL = 6.0, FINEST_STEP_M = 250.0, NODE_RAD = 0.035, GROUP_PX = 0.25;
enum { BORDER_PX = 2, FEWEST_LIMB_PX = 8 };
/* Air. */
static const double LEFT_OUT = 1e-5, BUMP_M = 6e3, LOWEST_BUMP_M = -15e3, LEAST_BUMP = 3e-3, LEAST_LEFT = 5e-5;
static const double LEAST_APART = 0.05, LEFT_LENGTH = 0.1, AIR_GAIN_SIGMA = 0.01, AIR_GAIN_LENGTH = 0.3;
static const double ENDS_STEP = 0.05, AT_POLE = 1e-9, SUNLIT_M = -20e3, SUNLIT_STEP_M = 20e3;
/* Noise: degrees of freedom of Student's distribution, and the weighed mean square of normal residuals. */
static const double FREEDOM = 10.0, OF_NORMAL = 0.8713634110071656;
static const double CLOUD_TOP_M = 16e3, DARK = 0.05, BRIGHT = 0.5, QUARTILE = 0.67448975;
static const double LEAST_COMMON = 1.1, SURELY_COMMON = 1.3, LEAST_SHARE_DARK = 0.01;
enum { FEWEST_PIXELS = 20, WEIGHINGS = 3, FEWEST_DARK = 50 };
/* Steps: lengths in standard deviations of the pose, changes of ln variance, gains in squared sigmas. */
enum { MOST_STEPS = 30, MOST_CUTS = 5, MOST_PAIRS = 10 };
static const double TOLERANCE = 0.03, STEADY = 0.02, NEARLY_STEADY = 0.2, REWEIGHED = 0.5, GOOD = 0.7, ROUNDING = 1e-3, HELD = 10.0;
static const double RESELECT_PX = 0.5, NEAR_PX = 0.25, LEAST_SHARE = 0.1;
static const double LARGEST_M = 15e3, LARGEST_PX = 3.0, LARGEST_LOG = 0.5;
static const double FINEST_M = 4e3, FINEST_PX = 0.5;
/* What is believed. */
static const double SCATTERED = 2.0, LEAST_EXPLAINED = 0.95, MOST_IMPROBABLE = 6.0, MOST_SIGMA = 5.0;

typedef struct {
  double R[3][3], r[3], lift;                        /* pose for which the pixels were chosen */
  double away[POSE];                                 /* displacement from there: turn, position, lift */
  double blur, sharpness, gain, background, z[MOST_UNKNOWNS - SHARED];
} State;
typedef struct {
  double value, light, column, row, h, along;        /* means of a group of pixels; along: from its node to the next */
  double y, by_pose[POSE];                           /* distance across the limb with its derivatives */
  double share, level, table[TABLES], kept, off;     /* prediction, its change by light, residual */
  double weight, variance, together, beyond, left;   /* noise: beyond dark pixels, of neglected air */
  double depth;                                      /* in the taper at the lower end of the window, 0 to 1 */
  int node, place;
} Pixel;
typedef struct {
  double key;                                        /* by which pixels are sorted */
  float h, along;
  int pixel, piece, on_limb;
} Key;
typedef struct {
  double width_m, box_m[2], lift_m;                  /* a pixel and its sides across the limb, shift by blur */
  double up[3], north[3], length[LIMB_K + 1][2];     /* Earth-fixed; of modes along the meridian and the parallel */
  double mean[LIMB_H], modes[LIMB_K + 1][LIMB_H], left[LIMB_H], ends[LIMB_K + 1][LIMB_H];
} Node;

static uint16_t image[MOST_PIXELS];
static int width, height;
static double full_scale;
static double fx, fy, cx, cy, sigma_r, sigma_q, month, sun_read[3], sun_known[3], blur_sigma, lift_sigma, gain_sigma;
static State prior;

static Pixel near_[ROWS];
static Node node[MOST_NODES];
static int count, group, nodes, functions, unknowns, air, half; /* half: steps of the grid of heights */
static int first_stage;
static double curve, pixel_m, bottom_y, taper_m, grid_low, grid_step, median_width, floor_level, floor_sigma, floor_space;
static int kind_of[FUNCTIONS], set_of[FUNCTIONS], offset_of[FUNCTIONS], rank_of[SETS], pivot_of[SETS][MOST_NODES];
static double wave[SETS][MOST_NODES][MOST_NODES + WIDE];

static double transform[MOST_NODES][FUNCTIONS][GRID], lens_at[MOST_NODES][4][GRID], summed[MOST_NODES][GRID], neglected[MOST_NODES][GRID];
static double table_at[MOST_NODES][GRID][TABLES], value_at[MOST_NODES][GRID][FUNCTIONS], largest_at[MOST_NODES];
static double coefficient[MOST_NODES][FUNCTIONS];
static double N[MOST_UNKNOWNS][MOST_UNKNOWNS + WIDE], U[MOST_UNKNOWNS][MOST_UNKNOWNS + WIDE], right_[MOST_UNKNOWNS];

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
        for (int k = 0; k < LIMB_K; k++) at->ends[k][h] = exp(-0.5 * pow(away / along[k], 2.0));
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
  for (int i = 0, j = 0; i <= half + 1; i++) {
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

/* The correlation of a function at two nodes, exp(-d^2 / 2 l^2) where its length is the same everywhere. With lengths l_n along
   the meridian and l_e along the parallel it varies at a node as one of the covariance S = l_e^2 1 + (l_n^2 - l_e^2) n n^T,
   and from one to the other (Paciorek and Schervish 2006, equation 1), S_m the mean of both,
   c = |S_i|^1/4 |S_j|^1/4 |S_m|^-1/2 exp(-d^T S_m^-1 d / 2). */
static double correlation_of(const Node *i, const Node *j, int set) {
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
static int root_of_covariance(int set, double sigma, double W[MOST_NODES][MOST_NODES + WIDE], int *pivots) {
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
      double v = correlation_of(&node[i], &node[pivot], set);
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

/* Shell's sort. */
static void sort(Key *x, int n) {
  int gap = 1;
  while (gap < n / 3) gap = 3 * gap + 1;
  for (; gap > 0; gap /= 3)
    for (int i = gap; i < n; i++) {
      Key v = x[i];
      int j = i;
      for (; j >= gap && x[j - gap].key > v.key; j -= gap) x[j] = x[j - gap];
      x[j] = v;
    }
}

/* The window */

/* The pose moves to where its unknowns say it is. */
static void rest(State *s) {
  turn(s->R, s->away);
  for (int i = 0; i < 3; i++) s->r[i] += s->away[3 + i];
  s->lift += s->away[6];
  memset(s->away, 0, sizeof s->away);
}

/* Noise at the lowest level, from the share and the mean of dark pixels there; 0 where the floor cuts nothing off, or
   where too few pixels show it. Space without the floor stays as it was: far below it no pixel shows how far. */
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

/* Whether a pixel or a neighbour is saturated: below full scale by its noise alone, or with charge of others in it. */
static int clipped(int column, int row) {
  for (int i = -2; full_scale > 0.0 && i <= 2; i++)
    for (int j = -2; j <= 2; j++)
      if (row + i >= 0 && row + i < height && column + j >= 0 && column + j < width &&
          image[(row + i) * width + column + j] >= full_scale)
        return 1;
  return 0;
}

/* Adds a pixel to the means of its group. */
static void add_pixel(const State *s, const Key *k, double share, Pixel *p) {
  double u[3], n[3], n_cam[3], arm[3], distance, by_height;
  int column = k->pixel % width, row = k->pixel / width;
  sight(column, row, u);
  double h = lowest(s, u, &distance, n);
  p->y += share * across(h - s->lift, &by_height);
  times(s->R[0], n, n_cam);
  cross(n_cam, u, arm);
  for (int i = 0; i < 3; i++) {
    p->by_pose[i] += share * by_height * distance * arm[i];
    p->by_pose[3 + i] += share * by_height * n[i];
  }
  p->by_pose[6] -= share * by_height;
  p->column += share * column, p->row += share * row, p->h += share * h;
  p->value += share * image[k->pixel], p->light += share * pow(u[2], 4.0), p->along += share * k->along;
}

/* A node whose azimuth has a line of sight u to a sphere's limb, and the nearest one in view. */
static void place_node(const State *s, double *u, const double *in_view, Node *at) {
  /* The limb of the ellipsoid is up to 21 km lower than that of a sphere. */
  for (int k = 0; k < 2; k++) {
    double n[3], n_cam[3], distance, h = lowest(s, u, &distance, n);
    times(s->R[0], n, n_cam);
    for (int i = 0; i < 3; i++) u[i] -= n_cam[i] * h / distance;
    unit(u);
  }
  look_up(s, u, at);
  double column = cx + fx * in_view[0] / in_view[2], row = cy + fy * in_view[1] / in_view[2];
  double here = across_at(s, column, row);
  double left = across_at(s, column - 1.0, row), right = across_at(s, column + 1.0, row);
  double above = across_at(s, column, row - 1.0), below = across_at(s, column, row + 1.0);
  at->box_m[0] = 0.5 * fabs(right - left), at->box_m[1] = 0.5 * fabs(below - above);
  at->width_m = hypot(at->box_m[0], at->box_m[1]);
  at->lift_m = 0.5 * (left + right + above + below - 4.0 * here);
}

/* Chooses the pixels near the limb; 0 if there is too little limb. Between nodes are equal numbers of pixels, from the
   end of the widest gap in azimuth on. */
static int choose(State *s) {
  static Key key[MOST_NEAR];
  double nadir[3], a[3], b[3], spare, widths[MOST_NODES];
  rest(s);
  double r2 = dot(s->r, s->r), to_limb_2 = fmax(r2 - A_M * A_M, 1.0);
  pixel_m = sqrt(to_limb_2) / fmax(fx, fy);
  double rim = EDGE_BLURS * sqrt(s->blur * s->blur + PIXEL_VARIANCE) * pixel_m;
  double bottom = s->lift - (DEPTH_PX + 0.5 * TAPER_PX) * pixel_m;
  double air_top = limb_height_m[LIMB_H - 1] + s->lift, top = air_top + fmax(rim, SPACE_PX * pixel_m);
  curve = 0.5 * A_M / to_limb_2, taper_m = TAPER_PX * pixel_m, bottom_y = across(bottom - s->lift, &spare);
  grid_low = bottom_y - GRID_RIMS * rim;
  double reach = across(top - s->lift, &spare) + ABOVE_RIMS * rim - grid_low; /* mirrored at its top is space */
  for (half = 64; half < HALF && half * pixel_m < reach * STEPS_PER_PIXEL;) half *= 2;
  grid_step = reach / half;
  floor_level = image[0];
  for (int i = 1; i < width * height; i++) floor_level = fmin(floor_level, image[i]);
  nadir_of(s, nadir);
  basis(nadir, a, b);
  int total = 0, limb = 0, dark = 0, at_floor = 0, first = 0, pieces;
  double dark_mean = 0.0;
  for (int row = BORDER_PX; row < height - BORDER_PX; row++)
    for (int column = BORDER_PX; column < width - BORDER_PX; column++) {
      double u[3], n[3], distance;
      sight(column, row, u);
      double h = lowest(s, u, &distance, n), above = image[row * width + column] - floor_level;
      if (distance <= 0.0 || h <= bottom || h >= top || clipped(column, row)) continue;
      if (h > air_top + rim) dark++, at_floor += above <= 0.0, dark_mean += above;
      Key *k = &key[total];
      k->key = atan2(dot(b, u), dot(a, u)), k->pixel = row * width + column, k->h = h;
      k->on_limb = fabs(h) < 0.5 * pixel_m / u[2]; /* off the axis pixels are smaller, and see the limb farther away */
      limb += k->on_limb;
      if (++total == MOST_NEAR) return 0;
    }
  if (limb < FEWEST_LIMB_PX) return 0;
  floor_sigma = noise_at_floor(dark, at_floor / fmax(dark, 1.0), dark_mean / fmax(dark, 1.0));
  sort(key, total);
  double gap = key[0].key + 2.0 * PI - key[total - 1].key, border[MOST_NODES], ends[2] = {1e9, -1e9};
  for (int i = 1; i < total; i++)
    if (key[i].key - key[i - 1].key > gap) gap = key[i].key - key[i - 1].key, first = i;
  double start = key[first].key, at_centre = sqrt(fmax(1.0 - A_M * A_M / r2, 0.0)), sine = sqrt(1.0 - at_centre * at_centre);
  for (int i = 0; i < total; i++) {
    key[i].key -= start - (key[i].key < start ? 2.0 * PI : 0.0);
    if (key[i].on_limb) ends[0] = fmin(ends[0], key[i].key), ends[1] = fmax(ends[1], key[i].key);
  }
  int sectors = (int)ceil((2.0 * PI - gap) * at_centre / NODE_RAD), most = limb / 2 < MOST_NODES - 1 ? limb / 2 : MOST_NODES - 1;
  sectors = sectors > most ? most : sectors < 2 ? 2 : sectors;
  nodes = sectors + 1;
  for (int m = 0; m < nodes; m++) {
    int i = (int)((double)m * total / sectors);
    border[m] = key[(first + (i < total ? i : total - 1)) % total].key;
  }
  /* Pieces of the limb are so long that pixels next to each other in height differ by GROUP_PX. */
  group = (total + MOST_ROWS - 1) / MOST_ROWS;
  pieces = group > 1 ? (int)(limb * GROUP_PX / (sectors * group)) : 1;
  if (pieces < 1) pieces = 1;
  for (int i = 0; i < total; i++) {
    Key *k = &key[(first + i) % total];
    int m = 0;
    while (m < sectors - 1 && k->key >= border[m + 1]) m++;
    k->along = clip((k->key - border[m]) / fmax(border[m + 1] - border[m], 1e-12), 0.0, 1.0);
    k->piece = m * pieces + (int)clip(k->along * pieces, 0.0, pieces - 1.0);
    k->key = k->piece + 0.999 * (k->h - bottom) / (top - bottom);
  }
  sort(key, total);
  count = 0;
  for (int i = 0, last; i < total; i = last) {
    for (last = i + 1; last < total && last < i + group && key[last].piece == key[i].piece;) last++;
    if (count == ROWS) return 0;
    Pixel *p = &near_[count++];
    memset(p, 0, sizeof *p);
    p->node = key[i].piece / pieces;
    for (int j = i; j < last; j++) add_pixel(s, &key[j], 1.0 / (last - i), p);
  }
  for (int m = 0; m < nodes; m++) {
    double u[3], in_view[3], t[2] = {border[m] + start, clip(border[m], ends[0], ends[1]) + start};
    for (int i = 0; i < 3; i++) {
      u[i] = sine * (cos(t[0]) * a[i] + sin(t[0]) * b[i]) + at_centre * nadir[i];
      in_view[i] = sine * (cos(t[1]) * a[i] + sin(t[1]) * b[i]) + at_centre * nadir[i];
    }
    place_node(s, u, in_view, &node[m]);
    widths[m] = node[m].width_m;
  }
  median_width = median(widths, nodes);
  return 1;
}

static double height_of(double g) {
  double y = grid_low + g * grid_step;
  return y - curve * y * y;
}

static double bump_at(int j, double h) { return cos(0.5 * PI * fmin(fabs(h - LOWEST_BUMP_M - j * BUMP_M) / BUMP_M, 1.0)); }

/* Functions of all nodes on the grid, transformed and blurred by the pixel; how their coefficients come of unknowns. */
static void functions_of_air(void) {
  static double shape[LIMB_H], left[MOST_NODES][GRID], spare[GRID];
  int second[LIMB_K + 1] = {0}, bump[BUMPS] = {0}, size = half + 1;
  double grid_last = grid_low + half * grid_step, share, largest[MOST_NODES];
  for (int k = 0; k < SETS; k++)
    rank_of[k] = root_of_covariance(k, k == LIMB_K + 1 ? AIR_GAIN_SIGMA : 1.0, wave[k], pivot_of[k]);
  /* Functions that are small at all nodes are left out; places as those of `limb-profile`, so that both leave out the same. */
  for (int m = 0; m < nodes; m++) {
    even(node[m].mean, transform[m][0]);
    even(node[m].left, left[m]);
    largest[m] = largest_of(transform[m][0], 1, size);
    for (double g = 0.0; g < half; g += fmax(FINEST_STEP_M, pixel_m / 12.0) / grid_step) {
      double h = height_of(g);
      int at = before(limb_height_m, LIMB_H, h, &share);
      double here = h > limb_height_m[LIMB_H - 1] ? 0.0 : (1.0 - share) * node[m].left[at] + share * node[m].left[at + 1];
      for (int j = 0; j < BUMPS; j++) bump[j] |= here * bump_at(j, h) > LEAST_BUMP * largest[m];
    }
    for (int k = 0; k < LIMB_K; k++)
      for (int i = 0; i < LIMB_H; i++)
        second[k] |= limb_height_m[i] > grid_low && limb_height_m[i] < grid_last &&
                     1.0 - pow(node[m].ends[k][i], 2.0) > LEAST_APART * LEAST_APART;
  }
  for (int g = 0; g < size; g++) {
    double out = height_of(g) > LOWEST_BUMP_M + BUMP_M ? 1.0 : 0.0;
    for (int j = 0; j < BUMPS; j++)
      if (bump[j]) out = fmax(out - pow(bump_at(j, height_of(g)), 2.0), 0.0);
    for (int m = 0; m < nodes; m++) neglected[m][g] = fmax(left[m][g], LEAST_LEFT * largest[m]) * sqrt(out);
  }
  for (int m = 0; m < nodes; m++) {
    double(*f)[GRID] = transform[m];
    functions = 1;
    for (int part = 0; part < 2; part++)
      for (int k = 0; k < LIMB_K; k++) {
        if (part == 1 && !second[k]) continue;
        for (int h = 0; h < LIMB_H; h++) {
          double c = node[m].ends[k][h];
          shape[h] = node[m].modes[k][h] * (part == 0 ? c : sqrt(1.0 - c * c));
        }
        set_of[functions] = k, kind_of[functions] = part * LIMB_K + k;
        even(shape, f[functions++]);
      }
    for (int j = 0; j < BUMPS; j++) {
      if (!bump[j]) continue;
      for (int g = 0; g < size; g++) f[functions][g] = left[m][g] * bump_at(j, height_of(g));
      set_of[functions] = LIMB_K, kind_of[functions++] = 2 * LIMB_K + j;
    }
    memcpy(f[functions], f[0], sizeof f[0]);
    set_of[functions] = LIMB_K + 1, kind_of[functions++] = 2 * LIMB_K + BUMPS;
    memset(spare, 0, sizeof spare);
    for (int k = 0; k < functions; k += 2) cosines(f[k], k + 1 < functions ? f[k + 1] : spare, half, 1.0);
    for (int g = 0; g < size; g++) {
      double frequency = g / (2.0 * half * grid_step), pixel = 1.0 / sinc(grid_step * frequency);
      for (int side = 0; side < 2; side++) pixel *= sinc(node[m].box_m[side] * frequency);
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

/* The lens's transform at the nodes and its change with ln blur: a Gaussian, and one of samples at whole pixels
   (Chebyshev: cos (k + 1) x = 2 cos x cos k x - cos (k - 1) x). */
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
    for (int g = 0; g <= half; g++) {
      double frequency = PI * g / (half * grid_step), one_way[2], change[2];
      double x2 = pow(blur * node[m].width_m * frequency, 2.0);
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
      lens_at[m][0][g] = exp(-0.5 * x2), lens_at[m][1][g] = one_way[0] * one_way[1];
      lens_at[m][2][g] = -x2 * lens_at[m][0][g];
      lens_at[m][3][g] = change[0] * one_way[1] + one_way[0] * change[1];
    }
}

/* What all pixels see as the unknowns say it. */
static void predict(const State *s) {
  static double re[2 * HALF], im[2 * HALF], change[2][GRID];
  lens(s->blur);
  for (int m = 0; m < nodes; m++) {
    for (int k = 1; k < functions; k++)
      coefficient[m][k] = product(wave[set_of[k]][m], s->z + offset_of[k], rank_of[set_of[k]]);
    for (int g = 0; g <= half; g++) {
      const double *smooth = lens_at[m][0], *sampled = lens_at[m][1], *by_blur = lens_at[m][2], *by_blur_2 = lens_at[m][3];
      double sum = transform[m][0][g], slope = g < half ? PI * g / half : 0.0; /* of frequencies in steps of the grid */
      for (int k = 1; k < functions; k++) sum += coefficient[m][k] * transform[m][k][g];
      summed[m][g] = sum;
      double blurred = sum * (smooth[g] + s->sharpness * (sampled[g] - smooth[g]));
      change[0][g] = sum * (by_blur[g] + s->sharpness * (by_blur_2[g] - by_blur[g]));
      change[1][g] = sum * (sampled[g] - smooth[g]);
      /* even for the profile itself, odd for its slope */
      re[g] = blurred * (1.0 + slope);
      if (g > 0) re[2 * half - g] = blurred * (1.0 - slope);
    }
    memset(im, 0, sizeof im);
    fft(re, im, 2 * half);
    cosines(change[0], change[1], half, 0.5 / half);
    for (int g = 0; g <= half; g++) {
      double *t = table_at[m][g];
      t[LEVEL] = re[g] * 0.5 / half, t[SLOPE] = im[g] * 0.5 / (half * grid_step);
      t[BY_BLUR] = change[0][g], t[BY_SHARPNESS] = change[1][g];
    }
    largest_at[m] = largest_of(table_at[m][0], TABLES, half + 1);
  }
  for (int i = 0; i < count; i++) {
    Pixel *p = &near_[i];
    double lift = (1.0 - p->along) * node[p->node].lift_m + p->along * node[p->node + 1].lift_m, two[2][TABLES];
    double y = p->y + product(s->away, p->by_pose, POSE) + lift * (s->blur * s->blur + PIXEL_VARIANCE);
    double at = (y - grid_low) / grid_step;
    p->place = (int)clip(at, 0.0, half - 1.0);
    p->share = clip(at - p->place, 0.0, 1.0);
    for (int g = 0; g < 2; g++)
      for (int t = 0; t < TABLES; t++)
        two[g][t] = (1.0 - p->along) * table_at[p->node][p->place + g][t] + p->along * table_at[p->node + 1][p->place + g][t];
    for (int t = 0; t < TABLES; t++) p->table[t] = two[0][t] + p->share * (two[1][t] - two[0][t]);
    /* Between two heights the cubic of their slopes: prediction and derivatives are of one piece. */
    double bend = 0.5 * grid_step * (two[0][SLOPE] - two[1][SLOPE]);
    double twist = grid_step * (two[0][SLOPE] + two[1][SLOPE]) - 2.0 * (two[1][LEVEL] - two[0][LEVEL]);
    double bow = p->share * (1.0 - p->share), bent = bend + (0.5 - p->share) * twist;
    p->table[LEVEL] += bow * bent;
    p->table[SLOPE] = (two[1][LEVEL] - two[0][LEVEL] + (1.0 - 2.0 * p->share) * bent - bow * twist) / grid_step;
    p->level = p->light * p->table[LEVEL];
    double shown = s->background + s->gain * p->level, z = (shown - floor_level) / floor_sigma;
    p->kept = floor_sigma > 0.0 ? normal(z) : 1.0;
    if (floor_sigma > 0.0) shown = floor_level + floor_sigma * (exp(-0.5 * z * z) / sqrt(2.0 * PI) + z * p->kept);
    p->off = p->value - shown;
    p->depth = clip((y - bottom_y) / taper_m, 0.0, 1.0);
  }
}

/* Chooses the window again. The air stays as it is: coefficients are taken over to nodes that lie a little elsewhere,
   from them to the unknowns at the nodes that were Cholesky's pivots. */
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
    double(*W)[MOST_NODES + WIDE] = wave[set_of[k]], *z = s->z + offset_of[k];
    for (int j = 0; j < rank_of[set_of[k]]; j++) {
      int m = pivot_of[set_of[k]][j];
      double at = (double)m * (had_nodes - 1) / (nodes - 1);
      int i = at < had_nodes - 2 ? (int)at : had_nodes - 2;
      z[j] = (at - i) * had[kind_of[k]][i + 1] + (i + 1 - at) * had[kind_of[k]][i];
      z[j] = (z[j] - product(W[m], z, j)) / W[m][j];
    }
  }
  predict(s);
  return 1;
}

/* Gain and background that fit best. */
static int levels(State *s) {
  double n = count, x = 0, y = 0, xx = 0, xy = 0;
  for (int i = 0; i < count; i++) {
    double level = near_[i].level;
    x += level, y += near_[i].value, xx += level * level, xy += level * near_[i].value;
  }
  s->gain = (n * xy - x * y) / (n * xx - x * x);
  s->background = floor_sigma > 0.0 ? floor_space : (y - s->gain * x) / n;
  predict(s);
  return s->gain > 0.0;
}

/* Noise */

/* The weight of a residual by Student's distribution, 1 in the middle. */
static double tail(double square, double variance) { return (FREEDOM + 1.0) / (FREEDOM + square / variance); }

/* Mean square of the residuals between two levels (of the brightest), with the weights of their own distribution. */
static double variance_between(double low, double high, double brightest) {
  static double square[ROWS], sorted[ROWS];
  int n = 0, all = 0;
  do {
    for (int i = 0; i < count; i++) {
      double level = clip(near_[i].level / brightest, 0.0, 1.0);
      if (all || (level > low && level < high)) square[n++] = near_[i].off * near_[i].off;
    }
    if (n > FEWEST_PIXELS || all) break;
    n = 0, all = 1;
  } while (1);
  memcpy(sorted, square, sizeof(double) * n);
  double mean = fmax(median(sorted, n) / (QUARTILE * QUARTILE), 1e-300);
  for (int round = 0; round < WEIGHINGS; round++) {
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += square[i] * tail(square[i], mean);
    mean = fmax(sum / (n * OF_NORMAL), 1e-300);
  }
  return mean;
}

/* The variance of the pixels by their residuals: that of dark pixels, and components by level, clouds and slope. */
static void estimate_noise(const State *s) {
  static double part[ROWS][3];
  double largest[3] = {1e-300, 1e-300, 1e-300}, x[3];
  for (int i = 0; i < count; i++) {
    const Pixel *p = &near_[i];
    const Node *at = &node[p->node];
    double bright = p->light * ((1.0 - p->along) * largest_at[p->node] + p->along * largest_at[p->node + 1]);
    double soft_m = sqrt(s->blur * s->blur + PIXEL_VARIANCE) * at->width_m;
    part[i][0] = fmax(p->level, 0.0);
    part[i][1] = pow(bright * normal((CLOUD_TOP_M - p->h) / soft_m), 2.0);
    part[i][2] = pow(p->light * p->table[SLOPE] * at->width_m, 2.0);
    for (int j = 0; j < 3; j++) largest[j] = fmax(largest[j], part[i][j]);
  }
  double dark = variance_between(-1.0, DARK, largest[0]), bright = variance_between(BRIGHT, 2.0, largest[0]);
  for (int i = 0; i < count; i++) {
    Pixel *p = &near_[i];
    const double *out = &neglected[p->node][p->place];
    for (int j = 0; j < 3; j++) part[i][j] /= largest[j];
    p->left = pow(s->gain * p->light * (out[0] + p->share * (out[1] - out[0])), 2.0);
    p->variance = fmax(dark + fmax(bright - dark, 0.0) * part[i][0], PIXEL_VARIANCE / group + p->left);
  }
  for (int round = 0; round < WEIGHINGS; round++) {
    double A[3][3] = {{0}}, b[3] = {0}, size[3];
    for (int i = 0; i < count; i++) {
      double square = near_[i].off * near_[i].off, v = near_[i].variance;
      double beyond = (square * tail(square, v) / OF_NORMAL - dark) / (v * v);
      for (int j = 0; j < 3; j++) {
        b[j] += part[i][j] * beyond;
        for (int k = 0; k < 3; k++) A[j][k] += part[i][j] * part[i][k] / (v * v);
      }
    }
    for (int j = 0; j < 3; j++) size[j] = sqrt(fmax(A[j][j], 1e-300));
    for (int j = 0; j < 3; j++) {
      b[j] /= size[j];
      for (int k = 0; k < 3; k++) A[j][k] = A[j][k] / (size[j] * size[k]) + (j == k ? 1e-9 : 0.0);
    }
    not_negative(A, b, x);
    for (int j = 0; j < 3; j++) x[j] /= size[j];
    for (int i = 0; i < count; i++) {
      Pixel *p = &near_[i];
      p->beyond = product(x, part[i], 3);
      p->variance = fmax(dark + p->beyond, PIXEL_VARIANCE / group + p->left);
    }
  }
}

/* How much larger the variance of the residuals' sums over squares is than of independent ones. */
static double correlated(void) {
  static double sum[MOST_SQUARES], number[MOST_SQUARES];
  double most = 1.0;
  for (int side = 4; side <= 32; side *= 2) {
    double side_px = group > 1 ? side * group / GROUP_PX : side, total = 0.0, pixels = 0.0;
    int in_row = (int)((width - 1) / side_px) + 1, squares = in_row * ((int)((height - 1) / side_px) + 1);
    for (int i = 0; i < squares; i++) sum[i] = number[i] = 0.0;
    for (int i = 0; i < count; i++) {
      const Pixel *p = &near_[i];
      int square = (int)(p->row / side_px) * in_row + (int)(p->column / side_px);
      sum[square] += p->off * sqrt(tail(p->off * p->off, p->variance) / p->variance);
      number[square] += 1.0;
    }
    for (int i = 0; i < squares; i++)
      if (number[i] > side) total += sum[i] * sum[i], pixels += number[i];
    most = fmax(most, total / fmax(pixels, 1.0));
  }
  return 1.0 + (most - 1.0) * clip((most - LEAST_COMMON) / (SURELY_COMMON - LEAST_COMMON), 0.0, 1.0);
}

/* Weights of the present residuals by their noise. */
static void take_weights(void) {
  for (int i = 0; i < count; i++) {
    Pixel *p = &near_[i];
    p->weight = tail(p->off * p->off, p->variance) / (p->variance * p->together);
  }
}

/* Estimates the noise, and how many pixels count as one: what residuals show beyond dark pixels has the correlation of
   their sums over squares, neglected air that of a bump's height and length. A limb that is still displaced, as at the
   beginning, would hide in that. Returns the change of the variances' logarithms (rms). */
static double weigh(const State *s, int beginning) {
  static double before[ROWS];
  double changed = 0.0, shown = 0.0;
  for (int i = 0; i < count; i++) before[i] = near_[i].variance * near_[i].together;
  estimate_noise(s);
  for (int i = 0; i < count; i++) shown += fmin(near_[i].beyond / near_[i].variance, 1.0) / count;
  double more = beginning ? 0.0 : (correlated() - 1.0) / fmax(shown, 1e-300);
  for (int i = 0; i < count; i++) {
    Pixel *p = &near_[i];
    double bump_px = fmax(BUMP_M * LEFT_LENGTH * EARTH_M / pow(node[p->node].width_m, 2.0) / group, 1.0);
    p->together = 1.0 + more * fmin(p->beyond / p->variance, 1.0);
    if (!beginning) p->together += (bump_px - 1.0) * fmin(p->left / p->variance, 1.0);
    p->together /= fmax(p->depth * p->depth * (3.0 - 2.0 * p->depth), LEAST_TAPER);
    changed += pow(log(p->variance * p->together / before[i]), 2.0) / count;
  }
  take_weights();
  return sqrt(changed);
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
  if (first_stage) information[BLUR] *= HELD, information[SHARPNESS] *= HELD;
  wanted[GAIN] = gain_sigma > 0.0 ? log(prior.gain / s->gain) : 0.0;
  information[GAIN] = gain_sigma > 0.0 ? 1.0 / (gain_sigma * gain_sigma) : 0.0;
  wanted[BACKGROUND] = floor_space - s->background;
  information[BACKGROUND] = floor_sigma > 0.0 ? 1.0 / (floor_sigma * floor_sigma) : 0.0;
}

/* Minus twice the log likelihood, up to a constant of the variances. */
static double merit_of(const State *s) {
  double wanted[SHARED], information[SHARED], sum = product(s->z, s->z, air);
  priors(s, wanted, information);
  for (int i = 0; i < SHARED; i++) sum += information[i] * wanted[i] * wanted[i];
  for (int i = 0; i < count; i++) {
    const Pixel *p = &near_[i];
    sum += (FREEDOM + 1.0) * log1p(p->off * p->off / p->variance / FREEDOM) / p->together;
  }
  return sum;
}

/* The transform of the lens at a node. */
static double lens_of(const State *s, int m, int g) {
  return lens_at[m][0][g] + s->sharpness * (lens_at[m][1][g] - lens_at[m][0][g]);
}

/* Derivatives of a pixel by the shared unknowns. */
static void by_shared(const State *s, const Pixel *p, double *J) {
  const Node *at = &node[p->node];
  double amplitude = s->gain * p->light * p->kept;
  double lifted = 2.0 * s->blur * s->blur * ((1.0 - p->along) * at[0].lift_m + p->along * at[1].lift_m);
  J[BLUR] = amplitude * (p->table[BY_BLUR] + p->table[SLOPE] * lifted);
  J[SHARPNESS] = amplitude * p->table[BY_SHARPNESS];
  J[GAIN] = amplitude * p->table[LEVEL];
  J[BACKGROUND] = p->kept;
  for (int c = 0; c < POSE; c++) J[TURN + c] = amplitude * p->table[SLOPE] * p->by_pose[c];
}

/* Half of the merit's gradient, downwards. The residuals are laid out on the nodes' grids and transformed: the product
   with all functions there is the product of the transforms. */
static void gradient(const State *s, double *out) {
  static double laid[MOST_NODES][2][GRID], pull[MOST_NODES][FUNCTIONS], re[2 * HALF], im[2 * HALF];
  double wanted[SHARED], information[SHARED], J[SHARED];
  priors(s, wanted, information);
  for (int j = 0; j < SHARED; j++) out[air + j] = information[j] * wanted[j];
  memset(laid, 0, sizeof laid);
  for (int i = 0; i < count; i++) {
    const Pixel *p = &near_[i];
    double weighed = p->weight * p->off, amplitude = weighed * s->gain * p->light * p->kept;
    double bow = p->share * (1.0 - p->share), bent = 2.0 * bow * (0.5 - p->share);
    by_shared(s, p, J);
    J[BLUR] -= s->gain * p->light * p->kept * p->table[BY_BLUR], J[SHARPNESS] = 0.0; /* they follow from the transforms */
    for (int j = 0; j < SHARED; j++) out[air + j] += weighed * J[j];
    for (int e = 0; e < 2; e++) {
      double along = amplitude * (e ? p->along : 1.0 - p->along);
      double *value = &laid[p->node + e][0][p->place], *slope = &laid[p->node + e][1][p->place];
      value[0] += along * (1.0 - p->share + bent), value[1] += along * (p->share - bent);
      slope[0] += along * bow * (1.0 - p->share), slope[1] -= along * bow * p->share;
    }
  }
  for (int m = 0; m < nodes; m++) {
    memset(im, 0, sizeof im);
    for (int g = 0; g <= half; g++) {
      int end = g == 0 || g == half;
      re[g] = end ? 2.0 * laid[m][0][g] : laid[m][0][g] + laid[m][1][g];
      if (!end) re[2 * half - g] = laid[m][0][g] - laid[m][1][g];
    }
    fft(re, im, 2 * half);
    for (int g = 0; g <= half; g++) {
      double(*l)[GRID] = lens_at[m], both = (g == 0 || g == half ? 0.25 : 0.5) / half * (re[g] + (g < half ? PI * g / half * im[g] : 0.0));
      out[air + BLUR] += both * summed[m][g] * (l[2][g] + s->sharpness * (l[3][g] - l[2][g]));
      out[air + SHARPNESS] += both * summed[m][g] * (l[1][g] - l[0][g]);
      laid[m][0][g] = both * lens_of(s, m, g);
    }
    for (int k = 1; k < functions; k++) pull[m][k] = product(laid[m][0], transform[m][k], half + 1);
  }
  for (int j = 1; j < functions; j++)
    for (int a = 0; a < rank_of[set_of[j]]; a++) {
      double sum = -s->z[offset_of[j] + a];
      for (int m = 0; m < nodes; m++) sum += wave[set_of[j]][m][a] * pull[m][j];
      out[offset_of[j] + a] = sum;
    }
}

/* All functions as the lens blurs them. */
static void tabulate(const State *s) {
  static double a[GRID], b[GRID];
  for (int m = 0; m < nodes; m++)
    for (int k = 1; k < functions; k += 2) {
      int other = k + 1 < functions ? k + 1 : k;
      for (int g = 0; g <= half; g++) a[g] = lens_of(s, m, g) * transform[m][k][g], b[g] = lens_of(s, m, g) * transform[m][other][g];
      cosines(a, b, half, 0.5 / half);
      for (int g = 0; g <= half; g++) value_at[m][g][k - 1] = a[g], value_at[m][g][other - 1] = b[g];
    }
}

/* Normal equations: sums at the nodes, where a pixel adds to two neighbours, then of the unknowns of the waves. */
static void equations(const State *s) {
  static double own[MOST_NODES + 1][FUNCTIONS][FUNCTIONS], next[MOST_NODES][FUNCTIONS][FUNCTIONS], row[4][ROW];
  static double to_shared[MOST_NODES + 1][FUNCTIONS][SHARED], square[ROW][ROW], pushed[MOST_NODES + 3][MOST_NODES + WIDE];
  double wanted[SHARED], information[SHARED], share[4];
  int added = functions - 1, columns = 2 * added + SHARED;
  tabulate(s);
  priors(s, wanted, information);
  for (int j = 0; j < SHARED; j++)
    for (int k = 0; k < SHARED; k++) N[air + j][air + k] = j == k ? information[j] : 0.0;
  memset(own, 0, sizeof own), memset(to_shared, 0, sizeof to_shared);
  for (int m = 0, i = 0; m + 1 < nodes; m++) {
    memset(square, 0, sizeof square);
    while (i < count && near_[i].node == m) {
      double weight[4] = {0, 0, 0, 0};
      for (int c = 0; c < 4 && i < count && near_[i].node == m; c++, i++) {
        const Pixel *p = &near_[i];
        weight[c] = p->weight;
        for (int e = 0; e < 2; e++) {
          double along = s->gain * p->light * p->kept * (e ? p->along : 1.0 - p->along);
          double low = along * (1.0 - p->share), high = along * p->share;
          const double *v = value_at[m + e][p->place], *w = value_at[m + e][p->place + 1];
          for (int k = 0; k < added; k++) row[c][e * added + k] = low * v[k] + high * w[k];
        }
        by_shared(s, p, row[c] + 2 * added);
      }
      for (int j = 0; j < columns; j++) {
        for (int c = 0; c < 4; c++) share[c] = weight[c] * row[c][j];
        add_rows(square[j], share, row[0], ROW, j + 1);
      }
    }
    for (int j = 0; j < added; j++) {
      for (int k = 0; k <= j; k++) own[m][j][k] += square[j][k], own[m + 1][j][k] = square[added + j][added + k];
      for (int k = 0; k < added; k++) next[m][j][k] = square[added + k][j];
      for (int k = 0; k < SHARED; k++)
        to_shared[m][j][k] += square[2 * added + k][j], to_shared[m + 1][j][k] = square[2 * added + k][added + j];
    }
    for (int j = 0; j < SHARED; j++)
      for (int k = 0; k <= j; k++) N[air + k][air + j] += square[2 * added + j][2 * added + k];
  }
  for (int j = 0; j < added; j++) {
    double(*W)[MOST_NODES + WIDE] = wave[set_of[j + 1]];
    int rank = rank_of[set_of[j + 1]], first = offset_of[j + 1];
    for (int k = j; k < added; k++) {
      double(*V)[MOST_NODES + WIDE] = wave[set_of[k + 1]];
      int other = rank_of[set_of[k + 1]];
      for (int m = 0; m < nodes; m++)
        for (int b = 0; b < other; b++)
          pushed[m][b] = own[m][k][j] * V[m][b] + (m + 1 < nodes ? next[m][j][k] * V[m + 1][b] : 0.0) +
                         (m > 0 ? next[m - 1][k][j] * V[m - 1][b] : 0.0);
      for (int a = 0; a < rank; a++) {
        double *out = N[first + a] + offset_of[k + 1];
        for (int b = 0; b < other; b++) out[b] = j == k && a == b;
        for (int m = 0; m < nodes; m += 4) {
          for (int c = 0; c < 4; c++) share[c] = m + c < nodes ? W[m + c][a] : 0.0;
          add_rows(out, share, pushed[m], MOST_NODES + WIDE, other);
        }
      }
    }
    for (int a = 0; a < rank; a++)
      for (int c = 0; c < SHARED; c++) {
        N[first + a][air + c] = 0.0;
        for (int m = 0; m < nodes; m++) N[first + a][air + c] += W[m][a] * to_shared[m][j][c];
      }
  }
}

/* U^T U = N, upper triangles. */
static int cholesky(void) {
  for (int i = 0; i < unknowns; i++) memcpy(U[i] + i, N[i] + i, sizeof(double) * (unknowns - i));
  for (int first = 0; first < unknowns; first += 4) {
    int last = first + 4 < unknowns ? first + 4 : unknowns;
    double share[4];
    for (int i = first; i < last; i++) {
      for (int k = first; k < i; k++)
        for (int j = unknowns - 1; j >= i; j--) U[i][j] -= U[k][i] * U[k][j];
      if (!(U[i][i] > 0.0)) return 0;
      double size = 1.0 / sqrt(U[i][i]);
      for (int j = i; j < unknowns; j++) U[i][j] *= size;
    }
    for (int i = last; i < unknowns; i++) {
      for (int c = 0; c < 4; c++) share[c] = -U[first + c][i];
      add_rows(U[i] + i, share, U[first] + i, MOST_UNKNOWNS + WIDE, unknowns - i);
    }
  }
  return 1;
}

/* N x = x */
static void solve(double *x) {
  for (int i = 0; i < unknowns; i++) {
    x[i] /= U[i][i];
    for (int k = i + 1; k < unknowns; k++) x[k] -= U[i][k] * x[i];
  }
  for (int i = unknowns - 1; i >= 0; i--) x[i] = (x[i] - product(U[i] + i + 1, x + i + 1, unknowns - i - 1)) / U[i][i];
}

static void move(State *s, const double *step) {
  const double *own = step + air;
  for (int i = 0; i < POSE; i++) s->away[i] += own[TURN + i];
  s->blur *= exp(own[BLUR]);
  s->sharpness += own[SHARPNESS];
  s->gain *= exp(own[GAIN]);
  s->background += own[BACKGROUND];
  for (int i = 0; i < air; i++) s->z[i] += step[i];
}

/* By how many pixels a way moves the limb at most. */
static double motion_px(const double *away) {
  double most = 0.0;
  for (int i = 0; i < count; i++) most = fmax(most, fabs(product(away, near_[i].by_pose, POSE)));
  return most / median_width;
}

/* The square of a step of the pose over its covariance: Cholesky's last rows. */
static double square_of(const double *step) {
  double square = 0.0;
  for (int i = unknowns - POSE; i < unknowns; i++) square += pow(product(U[i] + i, step + i, unknowns - i), 2.0);
  return square;
}

/* A step downwards, not longer than the derivatives reach; returns the gain that it promises. The normal matrix of an
   earlier state is corrected by the changes y of the gradient along the steps x since then (Broyden, Fletcher, Goldfarb,
   Shanno; J. Nocedal, Math. Comp. 35, 773, 1980). */
static double x_[MOST_PAIRS][MOST_UNKNOWNS], y_[MOST_PAIRS][MOST_UNKNOWNS];
static double step_of(const double *downwards, int pairs, double *step) {
  double part[MOST_PAIRS], size[MOST_PAIRS];
  memcpy(step, downwards, sizeof(double) * unknowns);
  for (int k = pairs - 1; k >= 0; k--) {
    size[k] = product(x_[k], y_[k], unknowns), part[k] = product(x_[k], step, unknowns) / size[k];
    for (int i = 0; i < unknowns; i++) step[i] -= part[k] * y_[k][i];
  }
  solve(step);
  for (int k = 0; k < pairs; k++) {
    double back = part[k] - product(y_[k], step, unknowns) / size[k];
    for (int i = 0; i < unknowns; i++) step[i] += back * x_[k][i];
  }
  double promised = product(step, downwards, unknowns), most_px = fmax(LARGEST_M / median_width, LARGEST_PX);
  double over = fmax(motion_px(step + air + TURN) / most_px, fmax(fabs(step[air + BLUR]), fabs(step[air + GAIN])) / LARGEST_LOG);
  if (!(over > 1.0)) return promised;
  for (int i = 0; i < unknowns; i++) step[i] /= over;
  return promised * (2.0 - 1.0 / over) / over;
}

/* Takes a step unless it makes the merit worse; returns by how much the merit falls. */
static double try_step(State *s, const double *step) {
  static State origin;
  double before = merit_of(s);
  origin = *s;
  move(s, step);
  predict(s);
  double gain = before - merit_of(s);
  if (!(gain > -ROUNDING)) *s = origin, predict(s), gain = fmin(gain, -2.0 * ROUNDING);
  take_weights();
  return gain;
}

/* One stage of the search; returns the steps it took, 0 without an answer, and says why. A step that gains nothing is cut
   to the minimum of the parabola through both merits. The noise is estimated after every step until it is steady, and
   again at the end. */
static int stage(State *s, double tolerance, double steady, const char **reason) {
  static double step[MOST_UNKNOWNS], before[MOST_UNKNOWNS];
  double square = INFINITY, changed = INFINITY;
  int pairs = 0, built = 0;
  *reason = "too little limb in view, or more pixels of it than this program holds";
  if (first_stage || motion_px(s->away) > NEAR_PX) {
    if (!select_pixels(s)) return 0;
    *reason = "the image is not brighter where the limb should be";
    if (first_stage && !levels(s)) return 0;
    weigh(s, first_stage);
  }
  *reason = "the limb in view does not determine the fit's unknowns";
  for (int number = 1; number <= MOST_STEPS; number++) {
    if (!built) {
      equations(s);
      if (!cholesky()) return 0;
      built = 1, pairs = 0;
    }
    gradient(s, before);
    double promised = step_of(before, pairs, step), gain = try_step(s, step);
    square = square_of(step);
    int close = square < tolerance * tolerance && promised < 1.0;
    for (int cut = 0; gain < -ROUNDING && cut < MOST_CUTS; cut++) {
      double share = clip(promised / (2.0 * promised - gain), LEAST_SHARE, 0.5);
      for (int i = 0; i < unknowns; i++) step[i] *= share;
      promised *= share * (2.0 - share), gain = try_step(s, step);
    }
    if (motion_px(s->away) > RESELECT_PX) {
      if (!select_pixels(s)) return 0;
      weigh(s, first_stage), changed = INFINITY, built = 0;
    } else if (changed < steady && (close || gain < -ROUNDING)) {
      if (first_stage || (changed = weigh(s, 0)) < steady) return number;
      pairs = 0;
    } else if (changed >= steady) {
      changed = weigh(s, first_stage), pairs = 0;
      built = gain > GOOD * promised && changed < REWEIGHED;
    } else {
      if (pairs == MOST_PAIRS) pairs = 0;
      gradient(s, right_);
      for (int i = 0; i < unknowns; i++) x_[pairs][i] = step[i], y_[pairs][i] = before[i] - right_[i];
      pairs += product(x_[pairs], y_[pairs], unknowns) > 0.0;
    }
  }
  *reason = "no convergence";
  return square < 1.0 ? MOST_STEPS : 0;
}

/* The most probable state near a start; returns the steps it took, 0 without an answer, and says why. */
static int search(State *s, const char **reason) {
  first_stage = 1;
  int first = stage(s, 1.0, NEARLY_STEADY, reason);
  first_stage = 0;
  int second = first ? stage(s, TOLERANCE, STEADY, reason) : 0;
  equations(s);
  if (!cholesky()) return 0;
  return second ? first + second : 0;
}

/* How many of the air's unknowns the pixels determine, the trace of 1 - C: the mean of their sum of squares. */
static double determined_air(void) {
  static double row[MOST_UNKNOWNS];
  double determined = air;
  for (int i = 0; i < air; i++) {
    /* a row of U's inverse */
    memset(row + i, 0, sizeof(double) * (unknowns - i));
    row[i] = 1.0;
    for (int j = i; j < unknowns; j++) {
      row[j] /= U[j][j];
      determined -= row[j] * row[j];
      for (int k = j + 1; k < unknowns; k++) row[k] -= row[j] * U[j][k];
    }
  }
  return determined;
}

/* Share of the pixels' variance that the prediction explains, by their weights in the tails. */
static double explained(void) {
  double used = 0.0, mean = 0.0, off = 0.0, whole = 0.0;
  for (int pass = 0; pass < 2; pass++)
    for (int i = 0; i < count; i++) {
      const Pixel *p = &near_[i];
      double weight = tail(p->off * p->off, p->variance);
      if (pass == 0) used += weight, mean += weight * p->value;
      else off += weight * p->off * p->off, whole += weight * pow(p->value - mean / used, 2.0);
    }
  return 1.0 - off / whole;
}

/* The start */

/* The tilt near the prior's attitude at which the predicted picture is most like a coarse copy of the image. */
static int start(State *s) {
  enum { MOST_COARSE = 64 * 64, AZIMUTHS = 24, MOST_GRID = 256, STEPS = 10, FINER_STEPS = 3, COARSE_PX = 56, FIRST_PX = 500 };
  static double value[MOST_COARSE], radius[MOST_COARSE], light[MOST_COARSE], u[MOST_COARSE][3];
  static double profile[AZIMUTHS][MOST_GRID], blurred[AZIMUTHS][MOST_GRID];
  static int bin[MOST_COARSE];
  static Node at;
  double nadir[3], a[3], b[3], distance = sqrt(dot(s->r, s->r)), to_limb = sqrt(distance * distance - A_M * A_M);
  double low = limb_height_m[0], fine = (limb_height_m[LIMB_H - 1] + 60e3 - low) / MOST_GRID, best[2] = {0, 0};
  double score = -INFINITY, spare, n_[3], cosine = to_limb / distance, sine = sqrt(1.0 - cosine * cosine);
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
    }
  for (int k = 0; k < AZIMUTHS; k++) {
    double angle = 2.0 * PI * k / AZIMUTHS, los[3];
    for (int i = 0; i < 3; i++) los[i] = sine * (cos(angle) * a[i] + sin(angle) * b[i]) + cosine * nadir[i];
    look_up(s, los, &at);
    for (int g = 0; g < MOST_GRID; g++) {
      double share, h = low + g * fine;
      int i = before(limb_height_m, LIMB_H, h, &share);
      profile[k][g] = h > limb_height_m[LIMB_H - 1] ? 0.0 : (1.0 - share) * at.mean[i] + share * at.mean[i + 1];
    }
  }
  double step = 3.5 * sigma_q / STEPS, pixel_rad = factor / fmax(fx, fy), finest = fmax(FINEST_M / to_limb, FINEST_PX * pixel_rad);
  for (int reach = STEPS, every = n / FIRST_PX | 1;; reach = FINER_STEPS, every = 1, step /= 3.0) {
    double sigma = fmax(step, pixel_rad) * to_limb * 0.5 / fine, middle[2] = {best[0], best[1]};
    int taps = (int)fmin(3.0 * sigma + 0.5, MOST_GRID);
    for (int k = 0; k < AZIMUTHS; k++)
      for (int g = 0; g < MOST_GRID; g++) {
        double sum = 0.0, weights = 0.0;
        for (int t = -taps; t <= taps; t += 1 + taps / 20) {
          double w = exp(-0.5 * t * t / (sigma * sigma));
          sum += w * profile[k][(int)clip(g + t, 0, MOST_GRID - 1)], weights += w;
        }
        blurred[k][g] = sum / weights;
      }
    for (int i = -reach; i <= reach; i++)
      for (int j = -reach; j <= reach; j++) {
        double tilt[2] = {middle[0] + i * step, middle[1] + j * step}, down[3], x = 0, y = 0, xx = 0, xy = 0, yy = 0;
        int used = (n + every - 1) / every;
        for (int c = 0; c < 3; c++) down[c] = nadir[c] + tilt[0] * a[c] + tilt[1] * b[c];
        unit(down);
        for (int p = 0; p < n; p += every) {
          double c = dot(down, u[p]), level = 0.0;
          y += value[p], yy += value[p] * value[p];
          if (c <= 0.0) continue;
          double g = (distance * sqrt(fmax(1.0 - c * c, 0.0)) - radius[p] - low) / fine;
          level = light[p] * blurred[bin[p]][g < 0.0 ? 0 : g > MOST_GRID - 1.0 ? MOST_GRID - 1 : (int)g];
          x += level, xx += level * level, xy += level * value[p];
        }
        double like = -(tilt[0] * tilt[0] + tilt[1] * tilt[1]) / (sigma_q * sigma_q), common = xy - x * y / used;
        if (common > 0.0)
          like -= used * log(fmax(1.0 - common * common / fmax((xx - x * x / used) * (yy - y * y / used), 1e-300), 1e-7));
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
      C[i][j] = N[air + j][air + i] - product(C[i], C[j], j);
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
