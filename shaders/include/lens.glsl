// Projection of a Gaussian through a lens other than a pinhole: the unscented transform (Wu et al.,
// 3DGUT, 2025), in f32.
//
// Seven points stand for the Gaussian, the lens takes each to the image, and the footprint has
// their mean and covariance. Up to where it ends a lens is followed; beyond, it goes on linearly in
// the chord 2 sin(angle / 2), which is finite even for what lies behind. No angle is ever computed:
// drivers may be 4096 units in the last place off in an arc tangent.

const uint LENS_PINHOLE = 0u;
const uint LENS_PLANAR = 1u; // a distorted pinhole: a function of x / z and y / z
const uint LENS_RADIAL = 2u; // a function of the angle, which its table has by chord
const uint LENS_INTERVALS = 63u;
const uint BEND_TERMS = 12u; // of the polynomials of a windshield, along each sine

struct Lens {
    uint kind;
    float tan_limit;       // of the angle where it ends
    float chord_limit;     // 2 sin of half that angle
    float slope_beyond;    // what the radius in the lens's plane grows by a chord beyond
    float pixels_per_rad;  // no two rays within 2 radians of the axis fall farther apart than this, by the angle between them
    float chord_intervals; // of the table, by chord
    vec4 matrix;           // pixels from the lens's plane, by columns
    float radial[6];
    vec2 tangential;
    vec4 thin_prism;
    vec2 table[LENS_INTERVALS + 1u]; // radius, and what it grows by an interval
    vec2 bend_limit; // tangents of half the angles along x and y up to which a windshield is followed; 0 without one
    vec2 bending[BEND_TERMS * BEND_TERMS]; // change of the sines: coefficients of u^i v^j at BEND_TERMS j + i, u and v the tangents over bend_limit
};

layout(constant_id = 16) const bool LENSES = false; // some camera is no pinhole

layout(set = 0, binding = 32, scalar) readonly buffer lenses_block { Lens lenses[]; }; // by camera

// The square root of three dimensions: how far the points stand from the mean, in standard
// deviations.
const float SIGMA_SPREAD = 1.7320508075688772;
const float SQRT_2 = 1.4142135623730951;
const float SQRT_SIXTH = 0.4082482904638631;

// Rays whose z is below this, of a unit length, are bent less by a windshield: none at 0.
const float BENDING_FADE_Z = 0.05;

// The ray behind the windshield of a point in camera axes; the point itself without a windshield.
vec3 bent(uint lens, vec3 t) {
    vec2 limit = lenses[lens].bend_limit;
    if (limit.x == 0.0) {
        return t;
    }
    vec3 ray = normalize(t);
    // Tangents of half the angles, whose sines these are: the angles are smooth functions of them.
    vec2 at = clamp(ray.xy / (1.0 + sqrt(max(1.0 - ray.xy * ray.xy, 0.0))) / limit, -1.0, 1.0);
    vec2 change = vec2(0.0);
    for (uint j = BEND_TERMS; j-- > 0u;) {
        vec2 row = vec2(0.0);
        for (uint i = BEND_TERMS; i-- > 0u;) {
            row = row * at.x + lenses[lens].bending[BEND_TERMS * j + i];
        }
        change = change * at.y + row;
    }
    vec2 sines = ray.xy + clamp(ray.z / BENDING_FADE_Z, 0.0, 1.0) * change;
    return vec3(sines, ray.z > 0.0 ? sqrt(max(1.0 - dot(sines, sines), 0.0)) : ray.z);
}

bool lens_shows_bent(uint lens, vec3 t) {
    return t.z > 0.0 && length(t.xy) <= lenses[lens].tan_limit * t.z;
}

bool lens_shows(uint lens, vec3 point) {
    vec3 t = bent(lens, point);
    return lens_shows_bent(lens, t);
}

vec2 distorted(uint lens, vec2 p) {
    float r2 = dot(p, p);
    float over = 1.0 + r2 * (lenses[lens].radial[0] + r2 * (lenses[lens].radial[1] + r2 * lenses[lens].radial[2]));
    float under = 1.0 + r2 * (lenses[lens].radial[3] + r2 * (lenses[lens].radial[4] + r2 * lenses[lens].radial[5]));
    vec2 tangential = lenses[lens].tangential;
    vec4 prism = lenses[lens].thin_prism;
    vec2 square = r2 + 2.0 * p * p;
    vec2 bent = vec2(2.0 * p.x * p.y * tangential.x + square.x * tangential.y, square.y * tangential.x + 2.0 * p.x * p.y * tangential.y);
    return p * (over / under) + bent + r2 * (prism.xz + r2 * prism.yw);
}

// The radius at a chord up to the limit: a cubic between two entries of the table.
float radius_at(uint lens, float chord) {
    float position = chord * lenses[lens].chord_intervals;
    uint interval = min(uint(position), LENS_INTERVALS - 1u);
    float s = position - float(interval);
    vec2 low = lenses[lens].table[interval];
    vec2 high = lenses[lens].table[interval + 1u];
    float rise = high.x - low.x;
    return low.x + s * (low.y + s * (3.0 * rise - 2.0 * low.y - high.y + s * (low.y + high.y - 2.0 * rise)));
}

// Projection of a point in camera axes, pixels from the principal point.
vec2 through_lens(uint lens, vec3 point) {
    vec3 t = bent(lens, point);
    vec3 ray = normalize(t);
    float across = length(ray.xy);
    float chord = ray.z >= 0.0 ? across * sqrt(2.0 / (1.0 + ray.z)) : sqrt(2.0 - 2.0 * ray.z);
    vec2 direction = across > 0.0 ? ray.xy / across : vec2(ray.z < 0.0 ? 1.0 : 0.0, 0.0);
    bool shown = lens_shows_bent(lens, t);
    vec2 p;
    if (lenses[lens].kind == LENS_PLANAR) {
        p = distorted(lens, shown ? t.xy / t.z : direction * lenses[lens].tan_limit);
    } else {
        p = direction * radius_at(lens, shown ? min(chord, lenses[lens].chord_limit) : lenses[lens].chord_limit);
    }
    if (!shown) {
        p += direction * (lenses[lens].slope_beyond * (chord - lenses[lens].chord_limit));
    }
    vec4 m = lenses[lens].matrix;
    return p.x * m.xy + p.y * m.zw;
}

// Turns two columns of a factor into each other so that `row` of the second becomes zero.
void turn_columns(inout vec3 first, inout vec3 second, int row) {
    float side = length(vec2(first[row], second[row]));
    if (side > 0.0) {
        float c = first[row] / side;
        float s = second[row] / side;
        vec3 turned = c * first + s * second;
        second = c * second - s * first;
        first = turned;
    }
}

// project_splat for a lens that is no pinhole.
bool project_splat_unscented(Camera camera, uint lens, vec3 t, mat3 axes, float opacity, out Footprint splat) {
    splat = Footprint(vec2(0.0), 0.0, 1.0, 1.0, -1.0);
    if (!(t.z >= NEAR_M)) {
        return false;
    }
    vec2 middle = through_lens(lens, t);
    bool shown = lens_shows(lens, t);
    // The triangular factor in the camera's axes: it is the same whichever factor of its covariance
    // the splat is stored by.
    vec3 columns[3] = vec3[3](to_camera_axes(camera, axes[0]), to_camera_axes(camera, axes[1]), to_camera_axes(camera, axes[2]));
    turn_columns(columns[0], columns[1], 0);
    turn_columns(columns[0], columns[2], 0);
    turn_columns(columns[1], columns[2], 1);
    vec2 points[7];
    vec2 shift = vec2(0.0);
    for (int axis = 0; axis < 3; ++axis) {
        vec3 offset = SIGMA_SPREAD * columns[axis];
        for (int side = 0; side < 2; ++side) {
            vec3 point = side == 0 ? t + offset : t - offset;
            shown = shown || lens_shows(lens, point);
            points[1 + 2 * axis + side] = through_lens(lens, point) - middle;
            shift += points[1 + 2 * axis + side];
        }
    }
    if (!shown) {
        return false;
    }
    shift /= 6.0;
    points[0] = -SQRT_2 * shift;
    float unit_px = max(1.0, max(abs(points[0].x), abs(points[0].y)));
    for (int i = 1; i < 7; ++i) {
        points[i] = SQRT_SIXTH * (points[i] - shift);
        unit_px = max(unit_px, max(abs(points[i].x), abs(points[i].y)));
    }
    // Covariance as in project_splat, with Lagrange's identity for the determinant: the sum of the
    // squares of all minors.
    float xx = 0.0, xy = 0.0, yy = 0.0, undilated = 0.0;
    for (int i = 0; i < 7; ++i) {
        points[i] /= unit_px;
        xx += points[i].x * points[i].x;
        xy += points[i].x * points[i].y;
        yy += points[i].y * points[i].y;
        for (int j = 0; j < i; ++j) {
            float minor = points[i].x * points[j].y - points[i].y * points[j].x;
            undilated += minor * minor;
        }
    }
    float dilation = DILATION_PX2 / (unit_px * unit_px);
    float determinant = undilated + dilation * (xx + yy) + dilation * dilation;
    float variance_y = yy + dilation;
    if (ANTIALIAS) {
        opacity *= sqrt(undilated / determinant);
    }
    splat.mean_px = camera.principal_px + (middle + shift);
    splat.slope = xy / variance_y;
    splat.rate_x = sqrt(HALF_LOG2_E * variance_y / determinant) / unit_px;
    splat.rate_y = sqrt(HALF_LOG2_E / variance_y) / unit_px;
    splat.log2_opacity = max(log2(opacity), -LOG2_255);
    return opacity >= ALPHA_MIN && splat.rate_x > 0.0 && splat.rate_y > 0.0 && abs(splat.slope) < 1e30
        && all(lessThan(abs(splat.mean_px), vec2(1e30)));
}

// project_splat, whatever the camera's lens.
bool project_splat_seen(Camera camera, uint lens, vec3 t, mat3 axes, float opacity, out Footprint splat) {
    if (LENSES && lenses[lens].kind != LENS_PINHOLE) {
        return project_splat_unscented(camera, lens, t, axes, opacity, splat);
    }
    return project_splat(camera, t, axes, opacity, splat);
}

// Upper bound of the arc sine, for sines up to a quarter.
float arc_sine_bound(float s) {
    return s * inversesqrt(1.0 - s * s);
}

// Ratio of a footprint's extent around its projected mean to the largest displacement of a sigma
// point. Points at sqrt(3) standard deviations move the mean of all by at most that displacement.
// Their variance is at most twice its square, and the cut-off multiplies it by sqrt(3): 1 +
// sqrt(6).
const float UNSCENTED_RADIUS = 3.45;

// True if a splat of the cluster may overlap the image of a camera: cluster_overlaps for a lens
// other than a pinhole.
//
// The means lie in a ball, within some angle of its center, and no lens takes rays so far apart in
// the image as its steepest place would. Balls near the camera or beside it are let pass: there are
// few.
bool cluster_overlaps_lens(Cluster cluster, Camera camera, uint lens) {
    vec3 center = from_camera_m(cluster.center_m, camera);
    float slack = 1e-5 * (dot(abs(center), vec3(1.0)) + dot(cluster.half_extent_m, vec3(1.0)) + cluster.splat_radius_m);
    if (cluster.splat_radius_m < 0.0 || !(farthest(cluster, center, camera.row_z) + slack >= NEAR_M)) {
        return false;
    }
    float distance_m = length(center);
    float spread_m = length(cluster.half_extent_m) + slack;
    float spread = spread_m / distance_m;
    float radius = cluster.splat_radius_m / (distance_m - spread_m);
    vec3 t = to_camera_axes(camera, center);
    if (!(spread < 0.25 && radius < 0.25 && t.z > 0.0)) {
        return true;
    }
    float angle_rad = 1.001 * (arc_sine_bound(spread) + UNSCENTED_RADIUS * arc_sine_bound(radius));
    // A pixel more than dilation needs, for rounding.
    vec2 margin = vec2(lenses[lens].pixels_per_rad * angle_rad + DILATION_RADIUS_PX + 1.0);
    vec2 pixel = camera.principal_px + through_lens(lens, t);
    return all(greaterThanEqual(pixel, -margin)) && all(lessThanEqual(pixel, vec2(camera.size_px) + margin));
}

// cluster_overlaps, whatever the camera's lens.
bool cluster_overlaps_any_lens(Cluster cluster, Camera camera, uint lens) {
    if (LENSES && lenses[lens].kind != LENS_PINHOLE) {
        return cluster_overlaps_lens(cluster, camera, lens);
    }
    return cluster_overlaps(cluster, camera);
}
