/* The tilt of a camera from one image of the limb, by rendered profiles: a reference for a flight computer. C99, no
   allocation, no library but libm. The program reads table.h of `horizonval templates` and has the model, the priors
   and the noise of the estimator `limb-profile` of horizonval, so that one can be tested against the other.

   A pixel whose line of sight passes at the height h over the ellipsoid (below 0: how deep it would come), between two
   nodes along the limb, is

       I = background + gain * light * P_s(y(h - lift) + c (s^2 + 1/12)) + noise,     P = mean + sum of a_k f_k

   P_s is the profile at the nodes, linear between them, as the pixel's two sides and a lens of s pixels blur it, and
   light the cosine of the off-axis angle to the fourth. y is the distance across the limb in which pixels are even,
   h = y - curve y^2, and c (s^2 + 1/12) the shift of a bent limb by blur. The functions f_k are the table's modes,
   those of the air once more where lines end, and the mean itself for a gain that varies along the limb. Unknown are turn (3), position (3), lift, ln blur, sharpness of the lens, ln gain,
   background, and unit unknowns z behind the coefficients at the nodes, a_k = W_k z, with W W^T their covariance
   exp(-d^2 / 2 l^2) for nodes a distance d apart at the Earth's centre.

   The program minimises, with priors as rows of the same equations,

       sum (nu + 1) ln(1 + r^2 / (nu v)) / together + priors,       (J^T W J + Q) step = J^T W r + Q (prior - now)

   Residuals r follow Student's distribution, W = (nu + 1) / (nu + r^2 / v) / (v together). The variance v is that of
   dark pixels plus components fitted to the squared residuals (level, clouds, slope), and not less than rounding and
   neglected air make. Where residuals are correlated, several pixels count together as one. Where the converter cuts
   noise off at its lowest level, the prediction is the mean of what is left. In the first of two stages the lens is held
   near its prior. The derivatives J are computed again only where a step gains less than
   they predict, or much, and at the end; until then a step costs one prediction and one product. Of more than 6000 pixels
   in squares near the limb 3000 to 6000 are taken, evenly spread.

   J has few entries in a row: the functions at the two nodes of the pixel, and the shared unknowns. Their products are
   summed at the nodes, of which only neighbours couple; the sums for the unknowns z follow from these.

   Not in this program: lenses with distortion, stated diffraction and blur over the field, foreign light outside the
   limb, a wider claim where limb and priors disagree, planets that are
   spheres, sigmas of the attitude by axis. A saturated pixel is known by full_scale alone. MOST_NODES is half of the most
   that `limb-profile` has, which matters only where more than 1.1 rad of limb at the Earth's centre are in view.

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
   Standard output: one JSON object, as docs/howto/estimator-program.md says. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "maths.h"
#include "table.h"

#define MOST_PIXELS (2048 * 2048)
#define MOST_SIDE 32767
#define MOST_SQUARES (MOST_PIXELS / 16 + MOST_SIDE / 2 + 1) /* of 4 pixels a side, in an image of any shape */
#define FEWEST_ROWS 3000
#define ROWS (2 * FEWEST_ROWS + 512) /* lines of pixels do not meet all squares evenly */
#define MOST_NODES 33
#define SETS (LIMB_K + 1)
#define FUNCTIONS (1 + LIMB_K + LIMB_ENDS + 1) /* mean, modes, what these of the air are where lines end, gain */
#define MOST_UNKNOWNS (SHARED + MOST_NODES * (FUNCTIONS - 1))
#define COLUMNS (2 * (FUNCTIONS - 1) + SHARED + WIDE)
#define THREE for (int i = 0; i < 3; i++)

/* Shared unknowns; the pose comes last, so that the last rows of Cholesky's triangle are its information. */
enum { BLUR, SHARPNESS, GAIN, BACKGROUND, TURN, POSITION = TURN + 3, LIFT = POSITION + 3, SHARED };
enum { POSE = SHARED - TURN };
/* Tables of a node over the grid of heights, and transforms of the lens. */
enum { LEVEL, SLOPE, BY_BLUR, BY_SHARPNESS, TABLES };
enum { SMOOTH, SAMPLED, SMOOTH_BY_BLUR, SAMPLED_BY_BLUR, LENSES };

static const double A_M = 6378137.0, EARTH_M = 6.371e6, PIXEL_VARIANCE = 1.0 / 12.0;
static const double SHARPNESS_PRIOR = 0.5, SHARPNESS_SIGMA = 0.5;
/* Window of heights, and grid beyond it. */
static const double DEPTH_PX = 0.5, TAPER_PX = 0.5, LEAST_TAPER = 1e-3, SPACE_PX = 4.0, EDGE_BLURS = 2.5, GRID_RIMS = 2.0;
static const double ABOVE_RIMS = 0.3, STEPS_PER_PIXEL = 6.0, NODE_RAD = 0.035, WIDER = 1.5, OBLIQUE = 0.382;
enum { BORDER_PX = 2, FEWEST_LIMB_PX = 8, SQUARE_PX = 8 };
/* Air. */
static const double LEFT_OUT = 1e-4, LEFT_M = 6e3, LEFT_LENGTH = 0.1;
static const double AIR_GAIN_SIGMA = 0.01, AIR_GAIN_LENGTH = 0.3;
static const double ENDS_STEP = 0.05, AT_POLE = 1e-9, SUNLIT_M = -20e3, SUNLIT_STEP_M = 20e3;
/* Noise: degrees of freedom of Student's distribution, and the weighed mean square of normal residuals. */
static const double FREEDOM = 10.0, OF_NORMAL = 0.8713634110071656;
static const double CLOUD_TOP_M = 16e3, DARK = 0.05, BRIGHT = 0.5, QUARTILE = 0.67448975;
static const double LEAST_COMMON = 1.1, SURELY_COMMON = 1.3, LEAST_SHARE_DARK = 0.01;
enum { FEWEST_PIXELS = 20, WEIGHINGS = 3, FEWEST_DARK = 50 };
/* Steps: lengths in standard deviations of nadir and altitude, changes of ln variance, gains in squared sigmas. */
static const double NEAR = 2.0, TOLERANCE = 0.1, STEADY = 0.5, REWEIGHED = 0.5, GOOD = 0.7, FROZEN = 1.0;
static const double ROUNDING = 1e-3, HELD = 10.0, FAR_PX = 3.0, RESELECT_PX = 0.5, NEAR_PX = 0.5, LEAST_SHARE = 0.1;
static const double LARGEST_M = 15e3, LARGEST_PX = 3.0, LARGEST_LOG = 0.5, FINEST_M = 4e3, FINEST_PX = 0.5;
enum { MOST_STEPS = 30, MOST_CUTS = 5, MOST_WEIGHS = 8 };
/* What is believed. */
static const double SCATTERED = 2.0, LEAST_EXPLAINED = 0.95, MOST_IMPROBABLE = 6.0, MOST_SIGMA = 5.0;

typedef struct {
  double R[3][3], r[3], lift;                        /* pose for which the pixels were chosen */
  double away[POSE];                                 /* displacement from there: turn, position, lift */
  double blur, sharpness, gain, background, z[MOST_UNKNOWNS - SHARED];
} State;
typedef struct {
  double u[3], up[3], n[3], distance, h, y, by_height; /* of a line of sight: normal below its lowest point, Earth-fixed */
} Ray;                                               /* and in camera axes, distance, height, distance across the limb */
typedef struct {
  double value, light, column, row, h, along;        /* along: from its node to the next */
  double y, by_pose[POSE];                           /* distance across the limb with its derivatives */
  double share, level, table[TABLES], passed, off;   /* prediction, share of its changes that passes the floor, residual */
  double weight, variance, together, beyond, left;   /* noise: beyond dark pixels, of neglected air */
  double depth;                                      /* in the taper at the lower end of the window, 0 to 1 */
  int node, place;
} Pixel;
typedef struct {
  double key;                                        /* by which pixels are sorted */
  int pixel, on_limb;
} Key;
typedef struct {
  double width_m, box_m[2], lift_m;                  /* a pixel and its sides across the limb, shift by blur */
  double up[3], north[3], length[LIMB_K + 1][2];     /* Earth-fixed; of modes along the meridian and the parallel */
  double mean[LIMB_H], modes[LIMB_K + 1][LIMB_H], left[LIMB_H], ends[LIMB_K + 1][LIMB_H];
} Node;

static uint16_t image[MOST_PIXELS];
static int width, height;
static double full_scale, fx, fy, cx, cy, sigma_r, sigma_q, month, sun_read[3], sun_known[3], blur_sigma, lift_sigma, gain_sigma;
static State prior;

static Pixel near_[ROWS];
static Key key[ROWS];
static Node node[MOST_NODES];
static int count, every, nodes, unknowns, air, half; /* half: steps of the grid of heights */
static int first_stage;
static double curve, pixel_m, bottom_y, taper_m, grid_low, grid_step, mean_width, floor_level, floor_sigma, floor_space;
static int offset_of[FUNCTIONS], rank_of[SETS];
static double wave[SETS][MOST_NODES][MOST_NODES + WIDE], coefficient[MOST_NODES][FUNCTIONS];

static double transform[MOST_NODES][FUNCTIONS][GRID], lens_at[MOST_NODES][LENSES][GRID], summed[MOST_NODES][GRID];
static double table_at[MOST_NODES][GRID][TABLES], value_at[MOST_NODES][GRID][FUNCTIONS], largest_at[MOST_NODES];
static double left_at[MOST_NODES][GRID];             /* standard deviation of what the functions leave */
static double N[MOST_UNKNOWNS][MOST_UNKNOWNS + WIDE], U[MOST_UNKNOWNS][MOST_UNKNOWNS + WIDE];

static Ray trace(const State *s, double column, double row) {
  static const double axes[3] = {6378137.0, 6378137.0, 6356752.314245};
  Ray a = {.u = {(column - cx) / fx, (row - cy) / fy, 1.0}};
  double d[3], p[3], e[3], q[3];
  unit(a.u);
  times_transposed(s->R[0], a.u, d);
  THREE p[i] = s->r[i] / axes[i], e[i] = d[i] / axes[i];
  a.distance = -dot(p, e) / dot(e, e);
  THREE q[i] = p[i] + a.distance * e[i], a.up[i] = q[i] / axes[i];
  double m = sqrt(dot(q, q)), size = sqrt(dot(a.up, a.up));
  unit(a.up);
  times(s->R[0], a.up, a.n);
  a.h = (m - 1.0) * m / size;
  double root = sqrt(fmax(1.0 - 4.0 * curve * (a.h - s->lift), 0.01));
  a.y = 2.0 * (a.h - s->lift) / (1.0 + root), a.by_height = 1.0 / root;
  return a;
}
static Ray trace_along(const State *s, const double *u) { return trace(s, cx + fx * u[0] / u[2], cy + fy * u[1] / u[2]); }
static double across(double h) { return 2.0 * h / (1.0 + sqrt(fmax(1.0 - 4.0 * curve * h, 0.01))); }

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

/* A place of the limb in the table: four rows with their shares by straight lines, and all rows with weights, which are
   those of splines where the Sun shines. */
typedef struct {
  int corner[4], rows, row[LIMB_A * LIMB_B + 4];
  double share[4], weight[LIMB_A * LIMB_B + 4];
} Place;

/* Towards the Sun, camera axes: its angle from the nadir is that of time and position, its azimuth that of the sensor. */
static void sun_of(const State *s, double *sun) {
  double nadir[3], level[3], down = -dot(sun_known, s->r) / sqrt(dot(s->r, s->r)), along;
  nadir_of(s, nadir);
  along = dot(sun_read, nadir);
  THREE level[i] = sun_read[i] - along * nadir[i];
  double size = sqrt(fmax(1.0 - down * down, 0.0)) / fmax(sqrt(dot(level, level)), 1e-9);
  int known = dot(sun_known, sun_known) > 0.0;
  THREE sun[i] = known ? down * nadir[i] + size * level[i] : sun_read[i];
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
    b = (second - limb_second[j]) / (j + 1 < LIMB_B ? limb_second[next] - limb_second[j] : limb_second[0] + 12.0 - limb_second[j]);
  } else {
    double sun[3];
    sun_of(s, sun);
    cross(n, u, up);
    first = acos(clip(dot(n, sun), -1.0, 1.0)), second = fabs(atan2(dot(up, sun), dot(u, sun)));
    j = before(limb_second, LIMB_B, second, &b), next = j + 1 < LIMB_B ? j + 1 : j;
  }
  i = before(limb_first, LIMB_A, first, &a), below = i + 1 < LIMB_A ? i + 1 : i;
  for (int c = 0; c < 4; c++) {
    at->corner[c] = (c < 2 ? i : below) * LIMB_B + (c % 2 ? next : j);
    at->share[c] = (c < 2 ? 1.0 - a : a) * (c % 2 ? b : 1.0 - b);
  }
  at->rows = LIMB_THERMAL ? 4 : LIMB_A * LIMB_B;
  if (!LIMB_THERMAL) spline_weights(limb_zenith, LIMB_Z, limb_zenith_slopes, first, row);
  if (!LIMB_THERMAL) spline_weights(limb_second, LIMB_B, limb_second_slopes, second, column);
  for (int k = 0; k < at->rows; k++) {
    at->row[k] = LIMB_THERMAL ? at->corner[k] : k;
    at->weight[k] = LIMB_THERMAL ? at->share[k] : row[k / LIMB_B] * column[k % LIMB_B];
  }
}

/* The mean at a height; splines are those of its root. */
static double mean_at(const Place *at, int h) {
  double sum = 0.0;
  for (int k = 0; k < at->rows; k++) {
    double value = limb_mean_scale[at->row[k]] * limb_mean[at->row[k] * LIMB_H + h];
    sum += at->weight[k] * (LIMB_THERMAL ? value : sqrt(fmax(value, 0.0)));
  }
  return LIMB_THERMAL ? sum : sum > 0.0 ? sum * sum : 0.0;
}

/* The table's profiles at a node. A line that passes below the height z from which light comes ends earlier, by the angle
   d = (2 (z - h) / R)^1/2: thermal means are those of the latitude there, and the correlation of a mode with what it is at
   the lowest point is exp(-d^2 / 2 l^2), l its length along the line. A line that passes h above the limb, l away, is
   turned by h / l, and its lowest point is nearer by that: sunlit means are those of the Sun there. */
static void look_up(const State *s, const Ray *a, Node *at) {
  enum { ENDS = 6 };
  static Place here, end[ENDS];
  double line_fixed[3], along[LIMB_K + 1], source = 0.0;
  memcpy(at->up, a->up, sizeof at->up);
  find(s, a->n, a->u, &here);
  THREE at->north[i] = (i == 2) - at->up[2] * at->up[i];
  double level = sqrt(dot(at->north, at->north));
  THREE at->north[i] = level > AT_POLE ? at->north[i] / level : 0.0;
  times_transposed(s->R[0], a->u, line_fixed);
  double northward = pow(dot(at->north, line_fixed), 2.0);
  for (int k = 0; k < LIMB_K; k++) {
    double *length = at->length[k];
    length[0] = length[1] = 0.0;
    for (int c = 0; c < 8; c++)
      length[c / 4] += here.share[c % 4] * limb_correlation_rad[(here.corner[c % 4] / LIMB_B * (LIMB_K + 1) + k) * 2 + c / 4];
    if (level <= AT_POLE) length[0] = length[1];
    along[k] = 1.0 / sqrt(northward / pow(length[0], 2.0) + (1.0 - northward) / pow(length[1], 2.0));
  }
  for (int h = 0; h < LIMB_H; h++) {
    at->mean[h] = mean_at(&here, h);
    at->left[h] = 0.0;
    for (int c = 0; c < 4; c++)
      at->left[h] += here.share[c] * limb_left_scale[here.corner[c]] * limb_left[here.corner[c] * LIMB_H + h];
    for (int k = 0; k < LIMB_K; k++) {
      at->modes[k][h] = 0.0;
      for (int j = 0, row; j < here.rows; j++)
        row = here.row[j] * (LIMB_K + 1) + k, at->modes[k][h] += here.weight[j] * limb_modes_scale[row] * limb_modes[row * LIMB_H + h];
    }
  }
  for (int e = 0; e < ENDS; e++) {
    double angle = LIMB_THERMAL ? e * ENDS_STEP : (SUNLIT_M + e * SUNLIT_STEP_M) * sqrt(2.0 * curve / EARTH_M), up[3], line[3];
    THREE up[i] = cos(angle) * a->n[i] - sin(angle) * a->u[i], line[i] = cos(angle) * a->u[i] + sin(angle) * a->n[i];
    find(s, up, LIMB_THERMAL ? a->u : line, &end[e]);
  }
  double largest = largest_of(at->mean, 1, LIMB_H);
  for (int h = 0; h < LIMB_H; h++)
    if (at->mean[h] >= 0.5 * largest) source = limb_height_m[h];
  for (int h = 0; h < LIMB_H; h++) {
    double away = sqrt(fmax(2.0 * (source - limb_height_m[h]) / EARTH_M, 0.0)), place = fmin(away / ENDS_STEP, ENDS - 1.001);
    if (!LIMB_THERMAL) place = clip((limb_height_m[h] - SUNLIT_M) / SUNLIT_STEP_M, 0.0, ENDS - 1.001);
    int e = (int)place;
    at->mean[h] = (e + 1 - place) * mean_at(&end[e], h) + (place - e) * mean_at(&end[e + 1], h);
    for (int k = 0; k < LIMB_K; k++) at->ends[k][h] = exp(-0.5 * pow(away / along[k], 2.0));
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

/* The correlation of a function at two nodes, exp(-d^2 / 2 l^2) where its length is the same everywhere. With lengths l_n
   along the meridian and l_e along the parallel it varies at a node as one of the covariance
   S = l_e^2 1 + (l_n^2 - l_e^2) n n^T, and from one to the other (Paciorek and Schervish 2006, equation 1), S_m the mean of
   both, c = |S_i|^1/4 |S_j|^1/4 |S_m|^-1/2 exp(-d^T S_m^-1 d / 2). */
static double correlation_of(const Node *i_, const Node *j, int set) {
  double d[3];
  THREE d[i] = i_->up[i] - j->up[i];
  double d2 = dot(d, d);
  if (set == LIMB_K) return exp(-0.5 * d2 / pow(AIR_GAIN_LENGTH, 2.0));
  double in2 = pow(i_->length[set][0], 2.0), ie2 = pow(i_->length[set][1], 2.0);
  double jn2 = pow(j->length[set][0], 2.0), je2 = pow(j->length[set][1], 2.0);
  double a = 0.5 * (ie2 + je2), b = 0.5 * (in2 - ie2) / a, c = 0.5 * (jn2 - je2) / a;
  double g = dot(i_->north, j->north), p = dot(i_->north, d), q = dot(j->north, d), D = (1.0 + b) * (1.0 + c) - b * c * g * g;
  double along = (b * (1.0 + c) * p * p - 2.0 * b * c * g * p * q + c * (1.0 + b) * q * q) / D;
  return pow(ie2 * ie2 * in2 * je2 * je2 * jn2, 0.25) / sqrt(a * a * a * D) * exp(-0.5 * (d2 - along) / a);
}

/* A square root of the covariance of the nodes: its eigenvectors (Jacobi's rotations) from the largest eigenvalue on, until
   little variance is left. */
static void root_of_covariance(int set) {
  double A[MOST_NODES][MOST_NODES], V[MOST_NODES][MOST_NODES], sum = 0.0, whole = nodes * (1.0 - LEFT_OUT);
  for (int i = 0; i < nodes; i++)
    for (int j = 0; j < nodes; j++) A[i][j] = correlation_of(&node[i], &node[j], set), V[i][j] = i == j;
  for (int sweep = 0; sweep < 8; sweep++)
    for (int p = 0; p < nodes; p++)
      for (int q = p + 1; q < nodes; q++) {
        if (fabs(A[p][q]) < 1e-9) continue;
        double angle = 0.5 * atan2(2.0 * A[p][q], A[q][q] - A[p][p]), c = cos(angle), d = sin(angle), x;
        for (int i = 0; i < nodes; i++) x = A[i][p], A[i][p] = c * x - d * A[i][q], A[i][q] = d * x + c * A[i][q];
        for (int i = 0; i < nodes; i++) x = A[p][i], A[p][i] = c * x - d * A[q][i], A[q][i] = d * x + c * A[q][i];
        for (int i = 0; i < nodes; i++) x = V[p][i], V[p][i] = c * x - d * V[q][i], V[q][i] = d * x + c * V[q][i];
      }
  int rank = 0;
  for (; rank < nodes && sum < whole; rank++) {
    int largest = 0;
    for (int i = 1; i < nodes; i++)
      if (A[i][i] > A[largest][largest]) largest = i;
    double size = sqrt(fmax(A[largest][largest], 0.0)) * (set == LIMB_K ? AIR_GAIN_SIGMA : 1.0);
    for (int i = 0; i < nodes; i++) wave[set][i][rank] = size * V[largest][i];
    sum += A[largest][largest], A[largest][largest] = -1.0;
  }
  rank_of[set] = rank;
}

/* The window */

/* Shell's sort. */
static void sort(Key *x, int n) {
  int gap = 1;
  while (gap < n / 3) gap = 3 * gap + 1;
  for (; gap > 0; gap /= 3)
    for (int i = gap, j; i < n; i++) {
      Key v = x[i];
      for (j = i; j >= gap && x[j - gap].key > v.key; j -= gap) x[j] = x[j - gap];
      x[j] = v;
    }
}

/* The pose moves to where its unknowns say it is. */
static void rest(State *s) {
  turn(s->R, s->away);
  THREE s->r[i] += s->away[3 + i];
  s->lift += s->away[6];
  memset(s->away, 0, sizeof s->away);
}

/* Noise at the lowest level, from the share and the mean of dark pixels there; 0 where the floor cuts nothing off, or
   where too few pixels show it. Space without the floor stays as it was: far below it no pixel shows how far. */
static double noise_at_floor(int dark, double share, double mean) {
  double low = -10.0, high = 10.0, sigma = mean;
  if (dark < FEWEST_DARK || !(share > LEAST_SHARE_DARK && share < 1.0 - LEAST_SHARE_DARK && mean > 0.0)) return 0.0;
  while (high - low > 1e-12) *(normal(0.5 * (low + high)) < share ? &low : &high) = 0.5 * (low + high);
  for (int i = 0; i < 20; i++) {
    double z = 0.5 / sigma - low;
    sigma = mean / (exp(-0.5 * z * z) / sqrt(2.0 * PI) + z * normal(z));
  }
  floor_space = floor_level + 0.5 - low * sigma;
  return sigma > 0.5 && sigma < 1e6 ? sigma : 0.0;
}

/* Whether a pixel or a neighbour is saturated: below full scale by its noise alone, or with charge of others in it. */
static int clipped(int column, int row) {
  for (int i = row - 2; full_scale > 0.0 && i <= row + 2; i++)
    for (int j = column - 2; j <= column + 2; j++)
      if (i >= 0 && i < height && j >= 0 && j < width && image[i * width + j] >= full_scale) return 1;
  return 0;
}

static void take_pixel(const State *s, int pixel, Pixel *p) {
  double arm[3];
  Ray a = trace(s, pixel % width, pixel / width);
  cross(a.n, a.u, arm);
  memset(p, 0, sizeof *p);
  p->y = a.y, p->by_pose[6] = -a.by_height, p->h = a.h, p->column = pixel % width, p->row = pixel / width;
  THREE p->by_pose[i] = a.by_height * a.distance * arm[i], p->by_pose[3 + i] = a.by_height * a.up[i];
  p->value = image[pixel], p->light = pow(a.u[2], 4.0);
}

/* Of how many pixels near the limb one is taken, a power of two: by squares of pixels whose middles are near it. */
static int thinned(const State *s, double bottom, double top) {
  double reach = (SQUARE_PX * sqrt(0.5) + 2.0) * pixel_m;
  int squares = 0, one_of = 1;
  for (int row = 0; row < height; row += SQUARE_PX)
    for (int column = 0; column < width; column += SQUARE_PX) {
      double middle = SQUARE_PX / 2;
      Ray ray = trace(s, fmin(column + middle, width - 1), fmin(row + middle, height - 1));
      double y = ray.y / ray.u[2]; /* off the axis a pixel sees less of the limb */
      squares += ray.distance > 0.0 && y > WIDER * bottom - reach && y < WIDER * top + reach;
    }
  while (squares * SQUARE_PX * SQUARE_PX / (2 * one_of) >= FEWEST_ROWS) one_of *= 2;
  return one_of;
}

/* A node whose azimuth has a line of sight u to a sphere's limb, and the nearest one in view. */
static void place_node(const State *s, double *u, const double *in_view, Node *at) {
  Ray a = trace_along(s, u);
  for (int k = 0; k < 2; k++) { /* the limb of the ellipsoid is up to 21 km lower than that of a sphere */
    THREE a.u[i] -= a.n[i] * a.h / a.distance;
    a = trace_along(s, a.u);
  }
  look_up(s, &a, at);
  double column = cx + fx * in_view[0] / in_view[2], row = cy + fy * in_view[1] / in_view[2];
  double left = trace(s, column - 1.0, row).y, right = trace(s, column + 1.0, row).y;
  double above = trace(s, column, row - 1.0).y, below = trace(s, column, row + 1.0).y;
  at->box_m[0] = 0.5 * fabs(right - left), at->box_m[1] = 0.5 * fabs(below - above);
  at->width_m = hypot(at->box_m[0], at->box_m[1]);
  at->lift_m = 0.5 * (left + right + above + below - 4.0 * trace(s, column, row).y);
}

/* Chooses the pixels near the limb; 0 if there is too little limb. Between nodes are equal numbers of pixels, from the
   end of the widest gap in azimuth on. */
static int choose(State *s) {
  double nadir[3], a[3], b[3], dark_mean = 0.0, border[MOST_NODES], ends[2] = {1e9, -1e9};
  int total = 0, limb = 0, dark = 0, at_floor = 0, first = 0;
  rest(s);
  double r2 = dot(s->r, s->r), to_limb_2 = fmax(r2 - A_M * A_M, 1.0);
  pixel_m = sqrt(to_limb_2) / fmax(fx, fy), curve = 0.5 * A_M / to_limb_2, taper_m = TAPER_PX * pixel_m;
  double rim = EDGE_BLURS * sqrt(s->blur * s->blur + PIXEL_VARIANCE) * pixel_m;
  double bottom = s->lift - (DEPTH_PX + 0.5 * TAPER_PX) * pixel_m, air_top = limb_height_m[LIMB_H - 1] + s->lift;
  double top = air_top + fmax(rim, SPACE_PX * pixel_m);
  bottom_y = across(bottom - s->lift), grid_low = bottom_y - GRID_RIMS * rim;
  double reach = across(top - s->lift) + ABOVE_RIMS * rim - grid_low; /* the mirror image at its top is space, too */
  for (half = 64; half < HALF && half * pixel_m < reach * STEPS_PER_PIXEL;) half *= 2;
  grid_step = reach / half, floor_level = image[0];
  for (int i = 1; i < width * height; i++) floor_level = fmin(floor_level, image[i]);
  nadir_of(s, nadir);
  basis(nadir, a, b);
  every = thinned(s, bottom, top);
  /* on oblique lines through the image, odd so that no column is empty: the same pixels for every pose near by */
  int line = (int)(OBLIQUE * every + 0.5) | 1;
  for (int row = BORDER_PX; row < height - BORDER_PX; row++)
    for (int column = BORDER_PX; column < width - BORDER_PX; column++) {
      if ((column + row * line) % every) continue;
      Ray ray = trace(s, column, row);
      double above = image[row * width + column] - floor_level;
      if (ray.distance <= 0.0 || ray.h <= bottom || ray.h >= top || clipped(column, row)) continue;
      if (ray.h > air_top + rim) dark++, at_floor += above <= 0.0, dark_mean += above;
      if (total == ROWS) return 0;
      Key *k = &key[total++];
      k->key = atan2(dot(b, ray.u), dot(a, ray.u)), k->pixel = row * width + column;
      /* off the axis pixels are smaller, and see the limb farther away */
      limb += k->on_limb = fabs(ray.h) < 0.5 * pixel_m / ray.u[2];
    }
  if (limb < FEWEST_LIMB_PX) return 0;
  floor_sigma = noise_at_floor(dark, at_floor / fmax(dark, 1.0), dark_mean / fmax(dark, 1.0));
  sort(key, total);
  double gap = key[0].key + 2.0 * PI - key[total - 1].key;
  for (int i = 1; i < total; i++)
    if (key[i].key - key[i - 1].key > gap) gap = key[i].key - key[i - 1].key, first = i;
  double start = key[first].key, at_centre = sqrt(fmax(1.0 - A_M * A_M / r2, 0.0)), sine = sqrt(1.0 - at_centre * at_centre);
  for (int i = 0; i < total; i++) {
    key[i].key -= start - (key[i].key < start ? 2.0 * PI : 0.0);
    if (key[i].on_limb) ends[0] = fmin(ends[0], key[i].key), ends[1] = fmax(ends[1], key[i].key);
  }
  int sectors = (int)clip(ceil((2.0 * PI - gap) * at_centre / NODE_RAD), 2.0, fmin(limb / 2, MOST_NODES - 1));
  nodes = sectors + 1;
  for (int m = 0; m < nodes; m++) {
    int i = (int)((double)m * total / sectors);
    border[m] = key[(first + (i < total ? i : total - 1)) % total].key;
  }
  for (count = 0; count < total; count++) {
    const Key *k = &key[(first + count) % total];
    int m = 0;
    while (m < sectors - 1 && k->key >= border[m + 1]) m++;
    take_pixel(s, k->pixel, &near_[count]);
    near_[count].node = m, near_[count].along = clip((k->key - border[m]) / fmax(border[m + 1] - border[m], 1e-12), 0.0, 1.0);
  }
  mean_width = 0.0;
  for (int m = 0; m < nodes; m++) {
    double u[3], in_view[3], t = border[m] + start, seen = clip(border[m], ends[0], ends[1]) + start;
    THREE u[i] = sine * (cos(t) * a[i] + sin(t) * b[i]) + at_centre * nadir[i];
    THREE in_view[i] = sine * (cos(seen) * a[i] + sin(seen) * b[i]) + at_centre * nadir[i];
    place_node(s, u, in_view, &node[m]);
    mean_width += node[m].width_m / nodes;
  }
  return 1;
}

/* The covariance of a function's coefficients: a mode's, or the gain's. */
static int set_of(int k) { return k <= LIMB_K ? k - 1 : k < FUNCTIONS - 1 ? limb_end[k - LIMB_K - 1] : LIMB_K; }

/* Functions of all nodes on the grid, transformed and blurred by the pixel; how their coefficients come of unknowns. */
static void functions_of_air(void) {
  static double shape[LIMB_H], spare[GRID];
  int size = half + 1;
  for (int m = 0; m < nodes; m++) {
    double(*f)[GRID] = transform[m];
    even(node[m].mean, f[0]);
    even(node[m].left, left_at[m]);
    for (int k = 1; k < FUNCTIONS - 1; k++) {
      for (int h = 0; h < LIMB_H; h++) {
        double alike = node[m].ends[set_of(k)][h];
        shape[h] = node[m].modes[set_of(k)][h] * (k > LIMB_K ? sqrt(1.0 - alike * alike) : alike);
      }
      even(shape, f[k]);
    }
    memcpy(f[FUNCTIONS - 1], f[0], sizeof f[0]);
    memset(spare, 0, sizeof spare);
    for (int k = 0; k < FUNCTIONS; k += 2) cosines(f[k], k + 1 < FUNCTIONS ? f[k + 1] : spare, half, 1.0);
    for (int g = 0; g < size; g++) {
      double frequency = g / (2.0 * half * grid_step), *box = node[m].box_m;
      double pixel = sinc(box[0] * frequency) * sinc(box[1] * frequency) / sinc(grid_step * frequency);
      for (int k = 0; k < FUNCTIONS; k++) f[k][g] *= pixel;
    }
  }
  air = 0;
  for (int k = 0; k < SETS; k++) root_of_covariance(k);
  for (int k = 1; k < FUNCTIONS; k++) offset_of[k] = air, air += rank_of[set_of(k)];
  unknowns = air + SHARED;
}

/* The lens's transforms at the nodes and their change with ln blur: a Gaussian, and one of samples at whole pixels
   (Chebyshev: cos (k + 1) x = 2 cos x cos k x - cos (k - 1) x). */
static void lens(double blur) {
  enum { MOST_PLACES = 64 };
  double weight[MOST_PLACES], steep[MOST_PLACES], sum = 1.0, sum_steep = 0.0;
  int places = (int)fmin(ceil(5.0 * blur), MOST_PLACES);
  for (int k = 0; k < places; k++) {
    double square = pow((k + 1) / fmax(blur, 0.15), 2.0);
    sum += weight[k] = 2.0 * exp(-0.5 * square), sum_steep += steep[k] = weight[k] * square;
  }
  for (int m = 0; m < nodes; m++)
    for (int g = 0; g <= half; g++) {
      double frequency = PI * g / (half * grid_step), one[2], change[2], x2 = pow(blur * node[m].width_m * frequency, 2.0);
      for (int side = 0; side < 2; side++) {
        double c = cos(node[m].box_m[side] * frequency), previous = 1.0, now = c, total = 1.0, by_blur = 0.0;
        for (int k = 0; k < places; k++) {
          total += weight[k] * now, by_blur += steep[k] * now;
          double next = 2.0 * c * now - previous;
          previous = now, now = next;
        }
        one[side] = total / sum, change[side] = (by_blur - one[side] * sum_steep) / sum;
      }
      lens_at[m][SMOOTH][g] = exp(-0.5 * x2), lens_at[m][SAMPLED][g] = one[0] * one[1];
      lens_at[m][SMOOTH_BY_BLUR][g] = -x2 * exp(-0.5 * x2);
      lens_at[m][SAMPLED_BY_BLUR][g] = change[0] * one[1] + one[0] * change[1];
    }
}

/* A mixture of smooth and sampled lens, of their transforms or of these by blur. */
static double mixed(const State *s, int m, int g, int which) {
  return lens_at[m][which][g] + s->sharpness * (lens_at[m][which + 1][g] - lens_at[m][which][g]);
}

/* What all pixels see as the unknowns say it. */
static void predict(const State *s) {
  static double re[2 * HALF], im[2 * HALF], change[2][GRID];
  lens(s->blur);
  for (int m = 0; m < nodes; m++) {
    for (int k = 1; k < FUNCTIONS; k++)
      coefficient[m][k] = product(wave[set_of(k)][m], s->z + offset_of[k], rank_of[set_of(k)]);
    memset(im, 0, sizeof im);
    for (int g = 0; g <= half; g++) {
      double sum = transform[m][0][g], slope = g < half ? PI * g / half : 0.0; /* of frequencies in steps of the grid */
      for (int k = 1; k < FUNCTIONS; k++) sum += coefficient[m][k] * transform[m][k][g];
      summed[m][g] = sum;
      change[0][g] = sum * mixed(s, m, g, SMOOTH_BY_BLUR);
      change[1][g] = sum * (lens_at[m][SAMPLED][g] - lens_at[m][SMOOTH][g]);
      /* even for the profile itself, odd for its slope */
      re[g] = sum * mixed(s, m, g, SMOOTH) * (1.0 + slope);
      if (g > 0) re[2 * half - g] = sum * mixed(s, m, g, SMOOTH) * (1.0 - slope);
    }
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
    p->place = (int)clip((y - grid_low) / grid_step, 0.0, half - 1.0);
    p->share = clip((y - grid_low) / grid_step - p->place, 0.0, 1.0);
    p->depth = clip((y - bottom_y) / taper_m, 0.0, 1.0);
    for (int t = 0; t < TABLES; t++) {
      for (int g = 0; g < 2; g++)
        two[g][t] = (1.0 - p->along) * table_at[p->node][p->place + g][t] + p->along * table_at[p->node + 1][p->place + g][t];
      p->table[t] = two[0][t] + p->share * (two[1][t] - two[0][t]);
    }
    /* Between two heights the cubic of their slopes: prediction and derivatives are of one piece. */
    double twist = grid_step * (two[0][SLOPE] + two[1][SLOPE]) - 2.0 * (two[1][LEVEL] - two[0][LEVEL]);
    double bow = p->share * (1.0 - p->share), bent = 0.5 * grid_step * (two[0][SLOPE] - two[1][SLOPE]) + (0.5 - p->share) * twist;
    p->table[LEVEL] += bow * bent;
    p->table[SLOPE] = (two[1][LEVEL] - two[0][LEVEL] + (1.0 - 2.0 * p->share) * bent - bow * twist) / grid_step;
    p->level = p->light * p->table[LEVEL];
    double shown = s->background + s->gain * p->level, z = (shown - floor_level) / floor_sigma;
    p->passed = floor_sigma > 0.0 ? normal(z) : 1.0;
    if (floor_sigma > 0.0) shown = floor_level + floor_sigma * (exp(-0.5 * z * z) / sqrt(2.0 * PI) + z * p->passed);
    p->off = p->value - shown;
  }
}

/* Chooses the functions again, and the window where it is asked to. The air stays as it is: coefficients are taken over to
   nodes that lie a little elsewhere. */
static int select_pixels(State *s, int window) {
  static double had[FUNCTIONS][MOST_NODES];
  int had_nodes = nodes;
  memset(had, 0, sizeof had);
  for (int k = 1; k < FUNCTIONS; k++)
    for (int m = 0; m < nodes; m++) had[k][m] = coefficient[m][k];
  if (window && !choose(s)) return 0;
  functions_of_air();
  memset(s->z, 0, sizeof s->z);
  for (int k = 1; had_nodes && k < FUNCTIONS; k++)
    for (int j = 0; j < rank_of[set_of(k)]; j++) {
      double sum = 0.0, squares = 0.0;
      for (int m = 0; m < nodes; m++) {
        double at = (double)m * (had_nodes - 1) / (nodes - 1), w = wave[set_of(k)][m][j];
        int i = at < had_nodes - 2 ? (int)at : had_nodes - 2;
        sum += w * ((at - i) * had[k][i + 1] + (i + 1 - at) * had[k][i]), squares += w * w;
      }
      s->z[offset_of[k] + j] = sum / squares;
    }
  predict(s);
  return 1;
}

/* Gain and background that fit best. */
static int levels(State *s) {
  double n = count, x = 0, y = 0, xx = 0, xy = 0;
  for (const Pixel *p = near_; p < near_ + count; p++)
    x += p->level, y += p->value, xx += p->level * p->level, xy += p->level * p->value;
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
  int n = 0;
  for (int all = 0; all < 2 && n <= FEWEST_PIXELS; all++, n = n > FEWEST_PIXELS || all ? n : 0)
    for (int i = 0; i < count; i++) {
      double level = clip(near_[i].level / brightest, 0.0, 1.0);
      if (all || (level > low && level < high)) key[n++].key = near_[i].off * near_[i].off;
    }
  sort(key, n);
  double mean = fmax(0.5 * (key[(n - 1) / 2].key + key[n / 2].key) / (QUARTILE * QUARTILE), 1e-300);
  for (int round = 0; round < WEIGHINGS; round++) {
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += key[i].key * tail(key[i].key, mean);
    mean = fmax(sum / (n * OF_NORMAL), 1e-300);
  }
  return mean;
}

/* The variance of the pixels by their residuals: that of dark pixels, and components by level, clouds and slope. */
static void estimate_noise(const State *s) {
  static double part[ROWS][3];
  double largest[3] = {1e-300, 1e-300, 1e-300}, x[3];
  for (int j = 0; j < count; j++) {
    const Pixel *p = &near_[j];
    const Node *at = &node[p->node];
    double bright = p->light * ((1.0 - p->along) * largest_at[p->node] + p->along * largest_at[p->node + 1]);
    double soft_m = sqrt(s->blur * s->blur + PIXEL_VARIANCE) * at->width_m;
    part[j][0] = fmax(p->level, 0.0), part[j][1] = pow(bright * normal((CLOUD_TOP_M - p->h) / soft_m), 2.0);
    part[j][2] = pow(p->light * p->table[SLOPE] * at->width_m, 2.0);
    THREE largest[i] = fmax(largest[i], part[j][i]);
  }
  double dark = variance_between(-1.0, DARK, largest[0]), bright = variance_between(BRIGHT, 2.0, largest[0]);
  for (int j = 0; j < count; j++) {
    Pixel *p = &near_[j];
    const double *out = &left_at[p->node][p->place];
    THREE part[j][i] /= largest[i];
    p->left = pow(s->gain * p->light * (out[0] + p->share * (out[1] - out[0])), 2.0);
    p->variance = fmax(dark + fmax(bright - dark, 0.0) * part[j][0], PIXEL_VARIANCE + p->left);
  }
  for (int round = 0; round < WEIGHINGS; round++) {
    double A[3][3] = {{0}}, b[3] = {0}, size[3];
    for (int j = 0; j < count; j++) {
      double square = near_[j].off * near_[j].off, v = near_[j].variance;
      double beyond = (square * tail(square, v) / OF_NORMAL - dark) / (v * v);
      THREE {
        b[i] += part[j][i] * beyond;
        for (int k = 0; k < 3; k++) A[i][k] += part[j][i] * part[j][k] / (v * v);
      }
    }
    THREE size[i] = sqrt(fmax(A[i][i], 1e-300));
    THREE {
      b[i] /= size[i];
      for (int k = 0; k < 3; k++) A[i][k] = A[i][k] / (size[i] * size[k]) + (i == k ? 1e-9 : 0.0);
    }
    not_negative(A, b, x);
    THREE x[i] /= size[i];
    for (Pixel *p = near_; p < near_ + count; p++) {
      p->beyond = dot(x, part[p - near_]);
      p->variance = fmax(dark + p->beyond, PIXEL_VARIANCE + p->left);
    }
  }
}

/* How much larger the variance of the residuals' sums over squares is than of independent ones. */
static double correlated(void) {
  static double sum[MOST_SQUARES], number[MOST_SQUARES];
  double most = 1.0;
  for (int side = 4; side <= 32; side *= 2) {
    double side_px = side * sqrt(every), total = 0.0, pixels = 0.0;
    int in_row = (int)((width - 1) / side_px) + 1, squares = in_row * ((int)((height - 1) / side_px) + 1);
    for (int i = 0; i < squares; i++) sum[i] = number[i] = 0.0;
    for (const Pixel *p = near_; p < near_ + count; p++) {
      int square = (int)(p->row / side_px) * in_row + (int)(p->column / side_px);
      sum[square] += p->off * sqrt(tail(p->off * p->off, p->variance) / p->variance), number[square] += 1.0;
    }
    for (int i = 0; i < squares; i++)
      if (number[i] > side) total += sum[i] * sum[i], pixels += number[i];
    most = fmax(most, total / fmax(pixels, 1.0));
  }
  return 1.0 + (most - 1.0) * clip((most - LEAST_COMMON) / (SURELY_COMMON - LEAST_COMMON), 0.0, 1.0);
}

/* Weights of the present residuals by their noise. */
static void take_weights(void) {
  for (Pixel *p = near_; p < near_ + count; p++) p->weight = tail(p->off * p->off, p->variance) / (p->variance * p->together);
}

/* Estimates the noise, and how many pixels count as one: what residuals show beyond dark pixels has the correlation of
   their sums over squares, what modes leave that of some height and length. Not in the first stage, where a limb that is
   still displaced would hide in it. Returns the change of the variances' logarithms (rms). */
static double weigh(const State *s) {
  static double before_[ROWS];
  double changed = 0.0, shown = 0.0;
  for (int i = 0; i < count; i++) before_[i] = near_[i].variance * near_[i].together;
  estimate_noise(s);
  for (int i = 0; i < count; i++) shown += fmin(near_[i].beyond / near_[i].variance, 1.0) / count;
  double more = first_stage ? 0.0 : (correlated() - 1.0) / fmax(shown, 1e-300);
  for (Pixel *p = near_; p < near_ + count; p++) {
    double left_px = fmax(LEFT_M * sqrt(2.0 * PI) * LEFT_LENGTH * EARTH_M / pow(node[p->node].width_m, 2.0) / every, 1.0);
    p->together = 1.0 + more * fmin(p->beyond / p->variance, 1.0);
    if (!first_stage) p->together += (left_px - 1.0) * fmin(p->left / p->variance, 1.0);
    p->together /= fmax(p->depth * p->depth * (3.0 - 2.0 * p->depth), LEAST_TAPER);
    changed += pow(log(p->variance * p->together / before_[p - near_]), 2.0) / count;
  }
  take_weights();
  return sqrt(changed);
}

/* Equations */

/* The step to the priors' values, and their information; shared unknowns. */
static void priors(const State *s, double *wanted, double *information) {
  turn_between(prior.R[0], s->R[0], wanted + TURN);
  THREE wanted[TURN + i] -= s->away[i], wanted[POSITION + i] = prior.r[i] - s->r[i] - s->away[3 + i];
  THREE information[TURN + i] = pow(sigma_q, -2.0), information[POSITION + i] = pow(sigma_r, -2.0);
  wanted[LIFT] = -s->lift - s->away[6], information[LIFT] = pow(lift_sigma, -2.0);
  wanted[BLUR] = log(prior.blur / s->blur), information[BLUR] = (first_stage ? HELD : 1.0) * pow(blur_sigma, -2.0);
  wanted[SHARPNESS] = prior.sharpness - s->sharpness;
  information[SHARPNESS] = (first_stage ? HELD : 1.0) * pow(SHARPNESS_SIGMA, -2.0);
  wanted[GAIN] = gain_sigma > 0.0 ? log(prior.gain / s->gain) : 0.0;
  information[GAIN] = gain_sigma > 0.0 ? pow(gain_sigma, -2.0) : 0.0;
  wanted[BACKGROUND] = floor_space - s->background, information[BACKGROUND] = floor_sigma > 0.0 ? pow(floor_sigma, -2.0) : 0.0;
}

/* Minus twice the log likelihood, up to a constant of the variances. */
static double merit_of(const State *s) {
  double wanted[SHARED], information[SHARED], sum = product(s->z, s->z, air);
  priors(s, wanted, information);
  for (int i = 0; i < SHARED; i++) sum += information[i] * wanted[i] * wanted[i];
  for (const Pixel *p = near_; p < near_ + count; p++)
    sum += (FREEDOM + 1.0) * log1p(p->off * p->off / p->variance / FREEDOM) / p->together;
  return sum;
}

/* Derivatives of a pixel by the shared unknowns. */
static void by_shared(const State *s, const Pixel *p, double *J) {
  const Node *at = &node[p->node];
  double amplitude = s->gain * p->light * p->passed, slope = amplitude * p->table[SLOPE];
  double lifted = 2.0 * s->blur * s->blur * ((1.0 - p->along) * at[0].lift_m + p->along * at[1].lift_m);
  J[BLUR] = amplitude * p->table[BY_BLUR] + slope * lifted, J[SHARPNESS] = amplitude * p->table[BY_SHARPNESS];
  J[GAIN] = amplitude * p->table[LEVEL], J[BACKGROUND] = p->passed;
  for (int c = 0; c < POSE; c++) J[TURN + c] = slope * p->by_pose[c];
}

/* Half of the merit's gradient, downwards. The residuals are laid out on the nodes' grids and transformed: the product
   with all functions there is the product of the transforms. */
static void gradient(const State *s, double *out) {
  static double laid[MOST_NODES][2][GRID], pull[MOST_NODES][FUNCTIONS], re[2 * HALF], im[2 * HALF], to_all[GRID];
  double wanted[SHARED], information[SHARED], J[SHARED];
  priors(s, wanted, information);
  for (int j = 0; j < SHARED; j++) out[air + j] = information[j] * wanted[j];
  memset(laid, 0, sizeof laid);
  for (const Pixel *p = near_; p < near_ + count; p++) {
    double weighed = p->weight * p->off, amplitude = s->gain * p->light * p->passed;
    double bow = p->share * (1.0 - p->share), bent = 2.0 * bow * (0.5 - p->share);
    by_shared(s, p, J);
    J[BLUR] -= amplitude * p->table[BY_BLUR], J[SHARPNESS] = 0.0; /* they follow from the transforms */
    for (int j = 0; j < SHARED; j++) out[air + j] += weighed * J[j];
    for (int e = 0; e < 2; e++) {
      double along = weighed * amplitude * (e ? p->along : 1.0 - p->along);
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
      double both = (g == 0 || g == half ? 0.25 : 0.5) / half * (re[g] + (g < half ? PI * g / half * im[g] : 0.0));
      out[air + BLUR] += both * summed[m][g] * mixed(s, m, g, SMOOTH_BY_BLUR);
      out[air + SHARPNESS] += both * summed[m][g] * (lens_at[m][SAMPLED][g] - lens_at[m][SMOOTH][g]);
      to_all[g] = both * mixed(s, m, g, SMOOTH);
    }
    for (int k = 1; k < FUNCTIONS; k++) pull[m][k] = product(to_all, transform[m][k], half + 1);
  }
  for (int j = 1; j < FUNCTIONS; j++)
    for (int a = 0; a < rank_of[set_of(j)]; a++) {
      double *sum = &out[offset_of[j] + a];
      *sum = -s->z[offset_of[j] + a];
      for (int m = 0; m < nodes; m++) *sum += wave[set_of(j)][m][a] * pull[m][j];
    }
}

/* All functions as the lens blurs them. */
static void tabulate(const State *s) {
  static double two[2][GRID];
  for (int m = 0; m < nodes; m++)
    for (int k = 1; k < FUNCTIONS; k += 2) {
      int other = k + 1 < FUNCTIONS ? k + 1 : k;
      for (int g = 0; g <= half; g++)
        two[0][g] = mixed(s, m, g, SMOOTH) * transform[m][k][g], two[1][g] = mixed(s, m, g, SMOOTH) * transform[m][other][g];
      cosines(two[0], two[1], half, 0.5 / half);
      for (int g = 0; g <= half; g++) value_at[m][g][k - 1] = two[0][g], value_at[m][g][other - 1] = two[1][g];
    }
}

/* Normal equations: sums at the nodes, where a pixel adds to two neighbours, then of the unknowns of the waves. Derivatives
   of a pixel: by the functions at its two nodes, then by the shared unknowns. */
static void equations(const State *s) {
  static double own[MOST_NODES + 1][FUNCTIONS][FUNCTIONS], next[MOST_NODES][FUNCTIONS][FUNCTIONS], row[4][COLUMNS];
  static double shared[MOST_NODES + 1][FUNCTIONS][SHARED], square[COLUMNS][COLUMNS], pushed[MOST_NODES + 3][MOST_NODES + WIDE];
  double wanted[SHARED], information[SHARED], share[4];
  int added = FUNCTIONS - 1, columns = 2 * added + SHARED;
  tabulate(s);
  priors(s, wanted, information);
  for (int j = 0; j < SHARED; j++)
    for (int k = 0; k < SHARED; k++) N[air + j][air + k] = j == k ? information[j] : 0.0;
  memset(own, 0, sizeof own), memset(shared, 0, sizeof shared);
  for (int m = 0, i = 0; m + 1 < nodes; m++) {
    memset(square, 0, sizeof square);
    while (i < count && near_[i].node == m) {
      double weight[4] = {0, 0, 0, 0};
      for (int c = 0; c < 4 && i < count && near_[i].node == m; c++, i++) {
        const Pixel *p = &near_[i];
        weight[c] = p->weight;
        for (int e = 0; e < 2; e++) {
          double along = s->gain * p->light * p->passed * (e ? p->along : 1.0 - p->along);
          const double *v = value_at[m + e][p->place], *w = value_at[m + e][p->place + 1];
          for (int k = 0; k < added; k++) row[c][e * added + k] = along * (v[k] + p->share * (w[k] - v[k]));
        }
        by_shared(s, p, row[c] + 2 * added);
      }
      for (int j = 0; j < columns; j++) {
        for (int c = 0; c < 4; c++) share[c] = weight[c] * row[c][j];
        add_rows(square[j], share, row[0], COLUMNS, j + 1);
      }
    }
    for (int j = 0; j < added; j++) {
      for (int k = 0; k <= j; k++) own[m][j][k] += square[j][k], own[m + 1][j][k] = square[added + j][added + k];
      for (int k = 0; k < added; k++) next[m][j][k] = square[added + k][j];
      for (int k = 0; k < SHARED; k++)
        shared[m][j][k] += square[2 * added + k][j], shared[m + 1][j][k] = square[2 * added + k][added + j];
    }
    for (int j = 0; j < SHARED; j++)
      for (int k = 0; k <= j; k++) N[air + k][air + j] += square[2 * added + j][2 * added + k];
  }
  for (int j = 0; j < added; j++) {
    double(*W)[MOST_NODES + WIDE] = wave[set_of(j + 1)];
    int rank = rank_of[set_of(j + 1)], first = offset_of[j + 1];
    for (int k = j; k < added; k++) {
      double(*V)[MOST_NODES + WIDE] = wave[set_of(k + 1)];
      int other = rank_of[set_of(k + 1)];
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
        for (int m = 0; m < nodes; m++) N[first + a][air + c] += W[m][a] * shared[m][j][c];
      }
  }
}

/* U^T U = N, upper triangles, four rows at a time. */
static int cholesky(void) {
  for (int i = 0; i < unknowns; i++) memcpy(U[i] + i, N[i] + i, sizeof(double) * (unknowns - i));
  for (int first = 0, last; first < unknowns; first = last) {
    last = first + 4 < unknowns ? first + 4 : unknowns;
    for (int i = first; i < last; i++) {
      for (int k = first; k < i; k++)
        for (int j = unknowns - 1; j >= i; j--) U[i][j] -= U[k][i] * U[k][j];
      if (!(U[i][i] > 0.0)) return 0;
      double size = 1.0 / sqrt(U[i][i]);
      for (int j = i; j < unknowns; j++) U[i][j] *= size;
    }
    for (int i = last; i < unknowns; i++) {
      double share[4] = {-U[first][i], -U[first + 1][i], -U[first + 2][i], -U[first + 3][i]};
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

/* By how many pixels a way moves the limb at most. */
static double motion_px(const double *away) {
  double most = 0.0;
  for (int i = 0; i < count; i++) most = fmax(most, fabs(product(away, near_[i].by_pose, POSE)));
  return most / mean_width;
}

/* The nadir's motion towards e, camera axes, by the pose: by the turn w it moves by w x nadir, by the position by
   -R (across r) / |r|. */
static void nadir_by_pose(const State *s, const double *nadir, const double *e, double *g) {
  double down[3], r2 = dot(s->r, s->r);
  cross(nadir, e, g);
  times_transposed(s->R[0], e, down);
  THREE g[3 + i] = -(down[i] - dot(down, s->r) / r2 * s->r[i]) / sqrt(r2);
  g[6] = 0.0;
}

/* The square of a pose's way in the claims for nadir and altitude, the larger of both; the last rows of Cholesky's
   triangle are the pose's information. */
static double square_of(const State *s, const double *way) {
  double nadir[3], e[2][3], g[POSE], x[3][POSE], moved[3], C[3][3];
  nadir_of(s, nadir);
  basis(nadir, e[0], e[1]);
  for (int k = 0; k < 3; k++) {
    if (k < 2) nadir_by_pose(s, nadir, e[k], g);
    else for (int i = 0; i < POSE; i++) g[i] = i < 3 || i == 6 ? 0.0 : s->r[i - 3] / sqrt(dot(s->r, s->r));
    moved[k] = product(g, way, POSE);
    for (int i = 0; i < POSE; i++) {
      x[k][i] = g[i];
      for (int j = 0; j < i; j++) x[k][i] -= U[unknowns - POSE + j][unknowns - POSE + i] * x[k][j];
      x[k][i] /= U[unknowns - POSE + i][unknowns - POSE + i];
    }
    for (int j = 0; j <= k; j++) C[j][k] = product(x[j], x[k], POSE);
  }
  double tilt = C[1][1] * moved[0] * moved[0] - 2.0 * C[0][1] * moved[0] * moved[1] + C[0][0] * moved[1] * moved[1];
  return fmax(tilt / (C[0][0] * C[1][1] - C[0][1] * C[0][1]), moved[2] * moved[2] / C[2][2]);
}

/* A step of the normal matrix as it is and the gradient as it is now, not longer than the derivatives reach. Returns the
   gain that it promises, and the square of the pose's part in the claims. */
static double step_of(const State *s, double *step, double *square) {
  static double downwards[MOST_UNKNOWNS];
  gradient(s, downwards);
  memcpy(step, downwards, sizeof(double) * unknowns);
  solve(step);
  double promised = product(step, downwards, unknowns), most_px = fmax(LARGEST_M / mean_width, LARGEST_PX);
  double over = fmax(motion_px(step + air + TURN) / most_px, fmax(fabs(step[air + BLUR]), fabs(step[air + GAIN])) / LARGEST_LOG);
  *square = square_of(s, step + air + TURN);
  for (int i = 0; over > 1.0 && i < unknowns; i++) step[i] /= over;
  return over > 1.0 ? promised * (2.0 - 1.0 / over) / over : promised;
}

/* Takes a step unless it makes the merit worse; returns by how much the merit falls. */
static double try_step(State *s, const double *step) {
  static State origin;
  const double *own = step + air, merit = merit_of(s);
  origin = *s;
  for (int i = 0; i < POSE; i++) s->away[i] += own[TURN + i];
  s->blur *= exp(own[BLUR]), s->sharpness += own[SHARPNESS], s->gain *= exp(own[GAIN]), s->background += own[BACKGROUND];
  for (int i = 0; i < air; i++) s->z[i] += step[i];
  predict(s);
  double gain = merit - merit_of(s);
  if (!(gain > -ROUNDING)) *s = origin, predict(s), gain = fmin(gain, -2.0 * ROUNDING);
  take_weights();
  return gain;
}

/* One stage of the search; returns the steps it took, 0 without an answer, and says why. A step that gains nothing is cut
   to the minimum of the parabola through both merits. The noise is estimated after every step until it is steady within a
   standard deviation of the pose, and held from then on: a minimum is that of one function. The last step is one by new
   derivatives. */
static int stage(State *s, double tolerance, double reselect_px, const char **reason) {
  static double step[MOST_UNKNOWNS];
  double square = INFINITY, moved = 0.0;
  int settled = 0, weighs = 0, built = 0;
  *reason = "too little limb in view, or more pixels of it than this program holds";
  if (!select_pixels(s, first_stage || motion_px(s->away) > NEAR_PX)) return 0;
  *reason = "the image is not brighter where the limb should be";
  if (first_stage && !levels(s)) return 0;
  weigh(s);
  *reason = "the limb in view does not determine the fit's unknowns";
  for (int number = 1; number <= MOST_STEPS; number++) {
    int fresh = !built, cuts = 0;
    if (fresh) equations(s);
    if (fresh && !cholesky()) return 0;
    double promised = step_of(s, step, &square), gain = try_step(s, step);
    if (square < tolerance * tolerance && (first_stage || (settled && promised < 1.0))) {
      if (fresh || first_stage) return number;
      built = 0;
      continue;
    }
    for (; fresh && gain < -ROUNDING && cuts < MOST_CUTS; cuts++) {
      double share = clip(promised / (2.0 * promised - gain), LEAST_SHARE, 0.5);
      for (int i = 0; i < unknowns; i++) step[i] *= share;
      promised *= share * (2.0 - share), gain = try_step(s, step);
    }
    built = gain > GOOD * promised - ROUNDING && promised < FROZEN;
    if (gain < -ROUNDING && fresh) break;
    if (gain < -ROUNDING) continue;
    moved += motion_px(step + air + TURN);
    if (cuts > 1 && !first_stage && gain < tolerance && moved < LEAST_SHARE * reselect_px) return number;
    if (moved > reselect_px || cuts > 1) {
      if (motion_px(s->away) > NEAR_PX && !select_pixels(s, 1)) return 0;
      weigh(s), built = 0, moved = 0.0;
    } else if (!settled) {
      double changed = weigh(s);
      settled = (square < 1.0 && changed < STEADY) || ++weighs == MOST_WEIGHS;
      built &= changed < REWEIGHED;
    }
  }
  *reason = "no convergence";
  return 0;
}

/* The most probable state near a start, first with the lens held; returns the steps it took, 0
   without an answer, and says why. */
static int search(State *s, const char **reason) {
  first_stage = 1;
  int first = stage(s, NEAR, FAR_PX, reason);
  first_stage = 0;
  int second = first ? stage(s, TOLERANCE, RESELECT_PX, reason) : 0;
  return second ? first + second : 0;
}

/* The start */

/* The tilt near the prior's attitude at which the predicted picture is most like a coarse copy of the image. */
static int start(State *s) {
  enum { MOST_COARSE = 64 * 64, AZIMUTHS = 24, MOST_GRID = 256, STEPS = 10, FINER_STEPS = 3, COARSE_PX = 56, FIRST_PX = 500 };
  static double value[MOST_COARSE], radius[MOST_COARSE], light[MOST_COARSE], u[MOST_COARSE][3];
  static double profile[AZIMUTHS][MOST_GRID], blurred[AZIMUTHS][MOST_GRID];
  static int bin[MOST_COARSE];
  static Node at;
  double nadir[3], a[3], b[3], distance = sqrt(dot(s->r, s->r)), to_limb = sqrt(distance * distance - A_M * A_M), down[3], w[3];
  double low = limb_height_m[0], fine = (limb_height_m[LIMB_H - 1] + 60e3 - low) / MOST_GRID, best[2] = {0, 0};
  double score = -INFINITY, cosine = to_limb / distance, sine = sqrt(1.0 - cosine * cosine), share;
  int n = 0, factor = ((width > height ? width : height) + COARSE_PX - 1) / COARSE_PX;
  curve = 0.5 * A_M / (to_limb * to_limb);
  nadir_of(s, nadir);
  basis(nadir, a, b);
  for (int row = 0; row + factor <= height; row += factor)
    for (int column = 0; column + factor <= width; column += factor, n++) {
      Ray ray = trace(s, column + (factor - 1) / 2, row + (factor - 1) / 2);
      value[n] = 0.0;
      for (int i = 0; i < factor * factor; i++)
        value[n] += image[(row + i / factor) * width + column + i % factor] / (double)(factor * factor);
      memcpy(u[n], ray.u, sizeof ray.u);
      light[n] = pow(ray.u[2], 4.0);
      double c = dot(nadir, ray.u);
      /* the Earth's radius there, as the ellipsoid has it; beyond a right angle from the nadir there is only space */
      radius[n] = c > 0.0 ? distance * sqrt(fmax(1.0 - c * c, 0.0)) - ray.h : 0.0;
      bin[n] = (int)floor(atan2(dot(b, ray.u), dot(a, ray.u)) * AZIMUTHS / (2.0 * PI) + AZIMUTHS + 0.5) % AZIMUTHS;
    }
  for (int k = 0; k < AZIMUTHS; k++) {
    double angle = 2.0 * PI * k / AZIMUTHS;
    Ray ray = {.distance = to_limb};
    THREE ray.u[i] = sine * (cos(angle) * a[i] + sin(angle) * b[i]) + cosine * nadir[i];
    THREE ray.n[i] = cosine * (cos(angle) * a[i] + sin(angle) * b[i]) - sine * nadir[i];
    times_transposed(s->R[0], ray.n, ray.up);
    look_up(s, &ray, &at);
    for (int g = 0; g < MOST_GRID; g++) {
      int i = before(limb_height_m, LIMB_H, low + g * fine, &share);
      profile[k][g] = low + g * fine > limb_height_m[LIMB_H - 1] ? 0.0 : (1.0 - share) * at.mean[i] + share * at.mean[i + 1];
    }
  }
  double step = 3.5 * sigma_q / STEPS, pixel_rad = factor / fmax(fx, fy), finest = fmax(FINEST_M / to_limb, FINEST_PX * pixel_rad);
  for (int reach = STEPS, every = n / FIRST_PX | 1;; reach = FINER_STEPS, every = 1, step /= 3.0) {
    double sigma = fmax(step, pixel_rad) * to_limb * 0.5 / fine, middle[2] = {best[0], best[1]};
    int taps = (int)fmin(3.0 * sigma + 0.5, MOST_GRID), used = (n + every - 1) / every;
    for (int k = 0; k < AZIMUTHS * MOST_GRID; k++) {
      double sum = 0.0, weights = 0.0;
      for (int t = -taps; t <= taps; t += 1 + taps / 20) {
        double weight = exp(-0.5 * t * t / (sigma * sigma));
        sum += weight * profile[k / MOST_GRID][(int)clip(k % MOST_GRID + t, 0, MOST_GRID - 1)], weights += weight;
      }
      blurred[k / MOST_GRID][k % MOST_GRID] = sum / weights;
    }
    score = -INFINITY;
    for (int k = 0; k < (2 * reach + 1) * (2 * reach + 1); k++) {
      double tilt[2] = {middle[0] + (k / (2 * reach + 1) - reach) * step, middle[1] + (k % (2 * reach + 1) - reach) * step};
      double x = 0, y = 0, xx = 0, xy = 0, yy = 0, like = -(tilt[0] * tilt[0] + tilt[1] * tilt[1]) / (sigma_q * sigma_q);
      THREE down[i] = nadir[i] + tilt[0] * a[i] + tilt[1] * b[i];
      unit(down);
      for (int p = 0; p < n; p += every) {
        double c = dot(down, u[p]), g = (distance * sqrt(fmax(1.0 - c * c, 0.0)) - radius[p] - low) / fine;
        double level = c > 0.0 ? light[p] * blurred[bin[p]][g < 0.0 ? 0 : g > MOST_GRID - 1.0 ? MOST_GRID - 1 : (int)g] : 0.0;
        y += value[p], yy += value[p] * value[p], x += level, xx += level * level, xy += level * value[p];
      }
      double common = xy - x * y / used, power = (xx - x * x / used) * (yy - y * y / used);
      if (common > 0.0) like -= used * log(fmax(1.0 - common * common / fmax(power, 1e-300), 1e-7));
      if (like > score) score = like, best[0] = tilt[0], best[1] = tilt[1];
    }
    if (step <= finest) break;
  }
  THREE down[i] = nadir[i] + best[0] * a[i] + best[1] * b[i];
  unit(down);
  cross(nadir, down, w);
  double length = sqrt(dot(w, w));
  THREE w[i] *= length > 0.0 ? asin(length) / length : 0.0;
  turn(s->R, w);
  return score > 0.0;
}

/* The answer */

static int refuse(const char *status, const char *reason) {
  printf("{\"status\": \"%s\", \"reason\": \"%s\"}\n", status, reason);
  return 0;
}

/* Share of the pixels' variance that the prediction explains, by their weights in the tails. */
static double explained(void) {
  double used = 0.0, mean = 0.0, off = 0.0, whole = 0.0;
  for (int i = 0; i < 2 * count; i++) {
    const Pixel *p = &near_[i % count];
    double weight = tail(p->off * p->off, p->variance);
    if (i < count) used += weight, mean += weight * p->value;
    else off += weight * p->off * p->off, whole += weight * pow(p->value - mean / used, 2.0);
  }
  return 1.0 - off / whole;
}

/* The largest coefficient of any function in its own standard deviations. */
static double improbable(void) {
  double most = 0.0;
  for (int k = 1; k < FUNCTIONS; k++)
    for (int m = 0; m < nodes; m++)
      most = fmax(most, fabs(coefficient[m][k]) / (k == FUNCTIONS - 1 ? AIR_GAIN_SIGMA : 1.0));
  return most;
}

/* By how much the air's unknowns scatter more than they should, 1 where chance may do so. The pixels determine as many
   as the trace of 1 - C, the mean of the sum of squares; its rows are those of U's inverse. */
static double strain(const State *s) {
  static double row[MOST_UNKNOWNS];
  double squares = product(s->z, s->z, air), determined = air;
  for (int i = 0; i < air; i++) {
    memset(row + i, 0, sizeof(double) * (unknowns - i));
    row[i] = 1.0;
    for (int j = i; j < unknowns; j++) {
      row[j] /= U[j][j];
      determined -= row[j] * row[j];
      for (int k = j + 1; k < unknowns; k++) row[k] -= row[j] * U[j][k];
    }
  }
  return squares > determined + SCATTERED * sqrt(2.0 * determined) ? squares / determined : 1.0;
}

/* Mean square of the nadir's error. Without the air's part it is that of the shared unknowns' own equations (Cholesky);
   strain makes that part larger. */
static double nadir_variance(const State *s, const double *nadir) {
  static double f[MOST_UNKNOWNS];
  double variance = 0.0, strained = strain(s), C[SHARED][SHARED], x[SHARED];
  for (int c = 0; c < 3; c++) {
    double e[3] = {c == 0, c == 1, c == 2}, g[SHARED] = {0}, known = 0.0;
    nadir_by_pose(s, nadir, e, g + TURN);
    for (int i = 0; i < SHARED; i++) {
      for (int j = 0; j <= i; j++) {
        C[i][j] = N[air + j][air + i] - product(C[i], C[j], j);
        C[i][j] = i == j ? sqrt(C[i][i]) : C[i][j] / C[j][j];
      }
      x[i] = (g[i] - product(C[i], x, i)) / C[i][i];
      known += x[i] * x[i];
    }
    memset(f, 0, sizeof f);
    memcpy(f + air, g, sizeof g);
    solve(f);
    variance += known + strained * (product(g, f + air, SHARED) - known);
  }
  return variance;
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
    return refuse("bad_input", "the image or the numbers before it cannot be read");
  double numbers = cx + cy + dot(s.r, s.r) + dot(q, q) + q[3] + month + dot(sun_read, sun_read) + dot(sun_known, sun_known);
  double above_0[] = {fx, fy, sigma_r, sigma_q, s.blur, blur_sigma, lift_sigma};
  for (size_t i = 0; i < sizeof above_0 / sizeof *above_0; i++)
    if (!(above_0[i] > 0.0 && isfinite(above_0[i]))) return refuse("bad_input", "focal lengths, blur and sigmas must be above 0");
  if (!isfinite(numbers + full_scale) || !isfinite(gain_sigma) || (gain_sigma > 0.0 && !(s.gain > 0.0 && isfinite(s.gain))))
    return refuse("bad_input", "a number before the image is not finite, or the gain not above 0");
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
  THREE
    if (fabs(w[i]) > MOST_SIGMA * sigma_q) return refuse("ambiguous", "the limb lies far from the prior's attitude");
  nadir_of(&s, nadir);
  printf("{\"status\": \"valid\", \"nadir_cam\": [%.12f, %.12f, %.12f], \"sigma_nadir_arcsec\": %.4f, \"reason\": ", nadir[0],
         nadir[1], nadir[2], sqrt(nadir_variance(&s, nadir)) * 180.0 / PI * 3600.0);
  printf("\"%d steps, %d pixels, %d nodes, %d unknowns\"}\n", steps, count, nodes, unknowns);
  return 0;
}
