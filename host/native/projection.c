#include "projection.h"

#include <math.h>

enum { NODES = 10 }; // Gauss-Legendre on [0, 1]
static const double NODE[NODES] = {
    0.013046735741414140, 0.067468316655507745, 0.160295215850487797, 0.283302302935376405, 0.425562830509184395,
    0.574437169490815605, 0.716697697064623595, 0.839704784149512203, 0.932531683344492255, 0.986953264258585860};
static const double WEIGHT[NODES] = {
    0.033335672154344069, 0.074725674575290296, 0.109543181257991022, 0.134633359654998178, 0.147762112357376435,
    0.147762112357376435, 0.134633359654998178, 0.109543181257991022, 0.074725674575290296, 0.033335672154344069};
static const double RADIANS = 0.017453292519943295;
static const double SMALL = 1e-3;       // tolerance: rad: below it the arc's quotients are taken from their series
static const double UNEVEN_MOST = 0.95; // limit: beyond 1 an end of the section would bend the other way
static const double NEAREST = 1e-6;     // limit: mm in front of the camera

struct turn {
    double m[9];
    int is; // not the identity
};

// Rodrigues' formula, degrees.
static struct turn turn_of(double x, double y, double z) {
    struct turn turn = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, 0};
    const double angle = sqrt(x * x + y * y + z * z) * RADIANS;
    if (angle == 0.0) {
        return turn;
    }
    const double a = x * RADIANS, b = y * RADIANS, c = z * RADIANS;
    const double s = angle < SMALL ? 1.0 - angle * angle / 6.0 : sin(angle) / angle;
    const double v = angle < SMALL ? 0.5 - angle * angle / 24.0 : (1.0 - cos(angle)) / (angle * angle);
    const double m[9] = {1.0 - v * (b * b + c * c), v * a * b - s * c,         v * a * c + s * b,
                         v * a * b + s * c,         1.0 - v * (a * a + c * c), v * b * c - s * a,
                         v * a * c - s * b,         v * b * c + s * a,         1.0 - v * (a * a + b * b)};
    for (int i = 0; i < 9; i++) {
        turn.m[i] = m[i];
    }
    turn.is = 1;
    return turn;
}

static void turned(const double *m, const double *x, double *out) {
    const double a = x[0], b = x[1], c = x[2];
    out[0] = m[0] * a + m[1] * b + m[2] * c;
    out[1] = m[3] * a + m[4] * b + m[5] * c;
    out[2] = m[6] * a + m[7] * b + m[8] * c;
}

// Where what is seen lies beside the tip's end, mm in the tip's frame at c deg, and its derivative per rad.
static void beside(const struct projection_rig *rig, double c_deg, double *at, double *rate) {
    const int last = PROJECTION_PLACES - 1;
    const double along = (c_deg - rig->place_from) / rig->place_step;
    const double x = fmin(fmax(along, 0.0), (double)last);
    const int i = x < last ? (int)x : last - 1;
    const double t = x - i, inside = along > 0.0 && along < last ? 1.0 / (rig->place_step * RADIANS) : 0.0;
    for (int k = 0; k < 3; k++) {
        const double *p = rig->place[k];
        const double gain = p[i + 1] - p[i];
        const double m = i > 0 ? 0.5 * (p[i + 1] - p[i - 1]) : gain;
        const double n = i + 1 < last ? 0.5 * (p[i + 2] - p[i]) : gain;
        const double b = 3.0 * gain - 2.0 * m - n, a = m + n - 2.0 * gain;
        at[k] = p[i] + t * (m + t * (b + t * a));
        rate[k] = inside * (m + t * (2.0 * b + 3.0 * t * a));
    }
}

// What is seen in the section's frame (x, y, z) mm at c rad, and its derivative per rad. The curvature goes from (1 -
// g) at the base to (1 + g), g = gradient + by_bend |c|, within UNEVEN_MOST.
static void bend(const struct projection_rig *rig, double gradient, double by_bend, double c, double *point,
                 double *slope) {
    const double length = rig->bending_length, tip = rig->tip_length;
    const double sine = sin(c), cosine = cos(c);
    double across, along, d_across, d_along; // of the section, per length
    if (gradient == 0.0 && by_bend == 0.0) {
        if (fabs(c) < SMALL) {
            across = c / 2 - c * c * c / 24;
            along = 1 - c * c / 6;
            d_across = 0.5 - c * c / 8;
            d_along = -c / 3 + c * c * c / 30;
        } else {
            across = (1 - cosine) / c;
            along = sine / c;
            d_across = (sine - across) / c;
            d_along = (cosine - along) / c;
        }
    } else { // the integral of the direction along the section
        const double wanted = gradient + by_bend * fabs(c), g = fmin(fmax(wanted, -UNEVEN_MOST), UNEVEN_MOST);
        const double g_rate = g == wanted ? by_bend * fabs(c) : 0.0; // times c
        across = along = d_across = d_along = 0.0;
        for (int i = 0; i < NODES; i++) {
            const double uneven = NODE[i] * NODE[i] - NODE[i];
            const double share = NODE[i] + uneven * g;
            const double rate = share + uneven * g_rate; // d (c share) / dc
            const double s = WEIGHT[i] * sin(c * share), o = WEIGHT[i] * cos(c * share);
            across += s;
            along += o;
            d_across += o * rate;
            d_along -= s * rate;
        }
    }
    point[0] = length * across + tip * sine;
    point[1] = 0.0;
    point[2] = length * along + tip * cosine;
    slope[0] = length * d_across + tip * cosine;
    slope[1] = 0.0;
    slope[2] = length * d_along - tip * sine;
    if (rig->place_step > 0.0) {
        double at[3], rate[3];
        beside(rig, c / RADIANS, at, rate);
        point[0] += cosine * at[0] + sine * at[2];
        point[1] = at[1];
        point[2] += cosine * at[2] - sine * at[0];
        slope[0] += cosine * (rate[0] + at[2]) + sine * (rate[2] - at[0]);
        slope[1] = rate[1];
        slope[2] += cosine * (rate[2] - at[0]) - sine * (rate[0] + at[2]);
    }
}

// du/dX and dv/dX, (2, 3) px per mm, at the same time as the image.
static int projected(const struct projection_rig *rig, const double *k, const double *x, double *image,
                     double *by_point) {
    if (!(x[2] > NEAREST)) {
        return 0;
    }
    const double a = x[0] / x[2], b = x[1] / x[2], r2 = a * a + b * b;
    const double radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    image[0] = rig->cx + rig->fx * (a * radial + 2 * k[2] * a * b + k[3] * (r2 + 2 * a * a));
    image[1] = rig->cy + rig->fy * (b * radial + k[2] * (r2 + 2 * b * b) + 2 * k[3] * a * b);
    const double rate = 2 * (k[0] + r2 * (2 * k[1] + 3 * r2 * k[4])); // d radial = rate (a da + b db)
    const double ua = radial + a * a * rate + 2 * k[2] * b + 6 * k[3] * a;
    const double cross = a * b * rate + 2 * k[2] * a + 2 * k[3] * b;
    const double vb = radial + b * b * rate + 6 * k[2] * b + 2 * k[3] * a;
    by_point[0] = rig->fx * ua / x[2];
    by_point[1] = rig->fx * cross / x[2];
    by_point[2] = -rig->fx * (ua * a + cross * b) / x[2];
    by_point[3] = rig->fy * cross / x[2];
    by_point[4] = rig->fy * vb / x[2];
    by_point[5] = -rig->fy * (cross * a + vb * b) / x[2];
    return 1;
}

static double along(const double *by_point, const double *direction) {
    return by_point[0] * direction[0] + by_point[1] * direction[1] + by_point[2] * direction[2];
}

void projection_image(const struct projection_parameters *e, const struct projection_rig *rig,
                      const struct projection_pose *pose, double *image, double *by_c, double *by_static) {
    const struct turn fixed = turn_of(e->static_rx, e->static_ry, e->static_rz);
    const struct turn late = turn_of(e->shift_rx, e->shift_ry, e->shift_rz);
    const struct turn up = turn_of(e->tilt_x, e->tilt_y, e->tilt_z);
    const struct turn down = turn_of(-e->tilt_x, -e->tilt_y, -e->tilt_z);
    const double fixed_move[3] = {e->static_x, e->static_y, e->static_z};
    const double late_move[3] = {e->shift_x, e->shift_y, e->shift_z};
    const double *d = rig->distortion;
    const double k[5] = {d[0] + e->k1, d[1] + e->k2, d[2] + e->p1, d[3] + e->p2, d[4] + e->k3};
    for (size_t n = 0; n < pose->count; n++) {
        double x[3], slope[3];
        bend(rig, e->curvature_gradient, e->curvature_by_bend, pose->c_deg[n] * RADIANS, x, slope);
        if (pose->translation) {
            x[2] += pose->translation[n];
        }
        if (pose->rotation) {
            const double s = sin(pose->rotation[n] * RADIANS), o = cos(pose->rotation[n] * RADIANS);
            const double across = x[0], along_x = slope[0];
            x[0] = o * across - s * x[1];
            x[1] = s * across + o * x[1];
            slope[0] = o * along_x - s * slope[1];
            slope[1] = s * along_x + o * slope[1];
        }
        if (up.is && pose->way && pose->way[n] != 0.0) {
            const double way = pose->way[n];
            const struct turn tilt = way == 1.0    ? up
                                     : way == -1.0 ? down
                                                   : turn_of(way * e->tilt_x, way * e->tilt_y, way * e->tilt_z);
            x[2] -= e->tilt_pivot;
            turned(tilt.m, x, x);
            turned(tilt.m, slope, slope);
            x[2] += e->tilt_pivot;
        }
        turned(fixed.m, x, x);
        turned(fixed.m, slope, slope);
        const double before[3] = {x[0], x[1], x[2]}; // the static move
        for (int i = 0; i < 3; i++) {
            x[i] += fixed_move[i];
        }
        const int shifted = pose->shifted && pose->shifted[n];
        if (shifted) {
            turned(late.m, x, x);
            turned(late.m, slope, slope);
            for (int i = 0; i < 3; i++) {
                x[i] += late_move[i];
            }
        }
        double seen[3], by_point[6];
        turned(rig->hand_eye, x, seen);
        for (int i = 0; i < 3; i++) {
            seen[i] += rig->translation[i];
        }
        if (!projected(rig, k, seen, &image[2 * n], by_point)) {
            image[2 * n] = image[2 * n + 1] = NAN;
            for (int i = 0; i < 6; i++) {
                by_point[i] = NAN;
            }
        }
        if (!by_c) {
            continue;
        }
        turned(rig->hand_eye, slope, slope);
        by_c[2 * n] = RADIANS * along(by_point, slope);
        by_c[2 * n + 1] = RADIANS * along(by_point + 3, slope);
        for (int i = 0; i < PROJECTION_STATIC; i++) {
            double way[3] = {0}; // where the point goes: a turn moves it by axis x point
            if (i < 3) {
                way[(i + 1) % 3] = -RADIANS * before[(i + 2) % 3];
                way[(i + 2) % 3] = RADIANS * before[(i + 1) % 3];
            } else {
                way[i - 3] = 1.0;
            }
            if (shifted) {
                turned(late.m, way, way);
            }
            turned(rig->hand_eye, way, way);
            by_static[(2 * n) * PROJECTION_STATIC + (size_t)i] = along(by_point, way);
            by_static[(2 * n + 1) * PROJECTION_STATIC + (size_t)i] = along(by_point + 3, way);
        }
    }
}
