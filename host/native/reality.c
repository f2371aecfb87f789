#include "reality.h"

#include <math.h>

// The straight piece of the width's table that holds x: value there and its slope. `near` is where to look first.
static double table_at(const struct reality_tables *t, double x, size_t *near, double *slope) {
    const size_t last = t->nodes - 2;
    size_t i = *near;
    *slope = 0.0;
    if (x <= t->grid[0]) {
        return t->width[0];
    }
    if (x >= t->grid[last + 1]) {
        return t->width[last + 1];
    }
    while (i > 0 && t->grid[i] > x) {
        i--;
    }
    while (i < last && t->grid[i + 1] <= x) {
        i++;
    }
    *near = i;
    *slope = (t->width[i + 1] - t->width[i]) / (t->grid[i + 1] - t->grid[i]);
    return t->width[i] + *slope * (x - t->grid[i]);
}

static double uniform(uint64_t *state) { // splitmix64
    uint64_t z = (*state += 0x9E3779B97F4A7C15ULL);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return (double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0;
}

// The pin in its slot: engagement z from -1 to 1, the pin is at q - z B/2. The slot is as wide as B where the pin is.
static double pin_at(const struct reality_tables *t, double q, double z, double scale, double extra, double from,
                     size_t *near) {
    double p = from;
    for (int i = 0; i < 40; i++) {
        double slope = 0.0;
        const double off = q - 0.5 * z * (scale * table_at(t, p, near, &slope) + extra) - p;
        if (fabs(off) < 1e-12) {
            break;
        }
        // Newton on a piece; damped where it goes to and fro between two of them.
        p += i < 8 ? off / fmax(1.0 + 0.5 * z * scale * slope, 0.1) : 0.5 * off;
    }
    return p;
}

void reality_transmission(const struct reality *r, const struct reality_tables *tables, const double *t_s,
                          const double *q, const double *width_factor, size_t n, double start, uint64_t seed, double *p,
                          double *way) {
    if (n == 0) {
        return;
    }
    double pin = isnan(start) ? q[0] : start;
    double speed = 0.0, first = pin, second = pin, kelvin_fast = pin, kelvin_slow = pin, grip = pin;
    double threshold = r->static_grip, ring = pin, ring_speed = 0.0, bent = 0.0, carried = 0.0, held = 0.0, since = 0.0;
    double set = 0.0; // share of what can set
    uint64_t random = seed;
    size_t near = 0;
    double straight = pin;
    for (size_t k = 0; k < n; k++) {
        const double dt = k ? t_s[k] - t_s[k - 1] : 0.0;
        const double dq = k ? q[k] - q[k - 1] : 0.0;
        if (dt > 0.0) {
            speed += (dq / dt - speed) * (1.0 - exp(-dt / 0.03));
        }
        const double scale = width_factor[k];
        const double extra = r->viscosity * fabs(speed) / (1.0 + fabs(speed) / r->speed_scale) + r->setting * set;
        const double before = pin;
        double slope = 0.0;
        const double width = fmax(scale * table_at(tables, pin, &near, &slope) + extra, 1e-9);
        double drive = q[k];
        const double favoured = r->latch > 0.0 ? 1.0 : -1.0;
        if (r->latch != 0.0) {
            const double caught = fmin(since / r->latch_travel, 1.0);
            held = fabs(r->latch) * 0.5 * (1.0 + cos(3.14159265358979 * caught));
            drive -= favoured * held;
        }
        // Only the favoured way meets the latch: the other way sees the motor as it is.
        const double z_free = 2.0 * (q[k] - pin) / width;
        const double z_held = 2.0 * (drive - pin) / width;
        double z = favoured > 0.0 ? (z_held > 1.0 ? z_held : fmin(z_free, 1.0))
                                  : (z_held < -1.0 ? z_held : fmax(z_free, -1.0));
        const double source = (favoured > 0.0 && z_held > 1.0) || (favoured < 0.0 && z_held < -1.0) ? drive : q[k];
        const double limit = 1.0 - r->softness;
        const double engaged = dq > 0.0 ? z : -z;
        if (dq != 0.0 && engaged > limit) {
            // Bending bristles: d(engagement) = d(travel) (1 - engagement) / softness beyond the limit.
            const double step = 2.0 * fabs(dq) / width;
            const double over = fmax(engaged - step - limit, 0.0);
            const double free = fmin(step, engaged - limit);
            double to = 1.0;
            if (r->softness > 0.0) {
                to = limit + r->softness - (r->softness - fmin(over, r->softness)) * exp(-free / r->softness);
            }
            pin = pin_at(tables, source, dq > 0.0 ? to : -to, scale, extra, pin, &near);
            if (carried * dq < 0.0) {
                since = 0.0;
            }
            carried = dq > 0.0 ? 1.0 : -1.0;
        }
        if (carried * favoured > 0.0) {
            since += fabs(dq);
        } else {
            since = 0.0;
        }

        if (r->setting > 0.0) {
            const double slid = fabs(pin - before);
            set =
                slid > 0.0 ? fmax(set - slid / r->setting_travel, 0.0) : 1.0 - (1.0 - set) * exp(-dt / r->setting_time);
        }
        double out = pin;
        if (r->dashpot > 0.0) {
            const double share = 1.0 - exp(-dt / (0.5 * r->dashpot));
            first += (out - first) * share;
            second += (first - second) * share;
            out = second;
        }
        if (r->creep_share > 0.0) {
            kelvin_fast += (out - kelvin_fast) * (1.0 - exp(-dt / r->creep_time));
            kelvin_slow += (out - kelvin_slow) * (1.0 - exp(-dt / (5.0 * r->creep_time)));
            out -= r->creep_share * (0.6 * (out - kelvin_fast) + 0.4 * (out - kelvin_slow));
        }
        if (r->static_grip > 0.0) {
            const double stretch = out - grip;
            if (fabs(stretch) > threshold) {
                grip = out - copysign(r->kinetic_grip * r->static_grip, stretch);
                threshold = r->static_grip * (1.0 + r->grip_scatter * (2.0 * uniform(&random) - 1.0));
            }
            out = grip;
        }
        if (r->ring_hz > 0.0) {
            const double omega = 6.283185307179586 * r->ring_hz;
            const int steps = 4;
            for (int i = 0; i < steps; i++) {
                const double h = dt / steps;
                ring_speed += h * (omega * omega * (out - ring) - 2.0 * r->ring_damping * omega * ring_speed);
                ring += h * ring_speed;
            }
            out = ring;
        }
        if (r->bulge != 0.0) {
            const double move = k ? out - straight : 0.0;
            straight = out;
            bent += move / r->bulge_travel - fabs(move) / r->bulge_travel * bent;
            out += r->bulge * bent * bent * bent;
        }
        p[k] = out;
        way[k] = carried;
    }
}

void reality_rocking(const double *p, const double *way, size_t n, double travel, double *lies) {
    double state = 0.0;
    for (size_t k = 0; k < n; k++) {
        const double step = k ? fabs(p[k] - p[k - 1]) : 0.0;
        state += (way[k] - state) * -expm1(-step / travel);
        lies[k] = state;
    }
}
