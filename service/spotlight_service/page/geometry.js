// Directions over a floor, seen by a camera. Camera space: x right, y up, z towards the camera.
// Azimuth in degrees round the floor's normal: 0 right, 90 behind, 180 left, 270 in front.

const RADIANS = Math.PI / 180;
/** Looking slightly down: of a scene whose floor is not known. */
const USUAL_NORMAL = [0, 0.94, 0.34];

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const scaled = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const unit = (a) => scaled(a, 1 / Math.hypot(...a));
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
export const wrapped = (degrees) => ((degrees % 360) + 360) % 360;
export const clamped = (value, low, high) => Math.min(high, Math.max(low, value));

/** Axes of a floor: right and away from the camera lie in it, up is its normal. */
export function floorFrame(normal) {
  const up = unit(normal || USUAL_NORMAL);
  const right = unit(add([1, 0, 0], scaled(up, -up[0])));
  return { right, away: cross(up, right), up };
}

export function direction({ right, away, up }, azimuth, elevation) {
  const a = azimuth * RADIANS;
  const e = elevation * RADIANS;
  const flat = add(scaled(right, Math.cos(a)), scaled(away, Math.sin(a)));
  return add(scaled(flat, Math.cos(e)), scaled(up, Math.sin(e)));
}

export function angles({ right, away, up }, towards) {
  const d = unit(towards);
  const azimuth = wrapped(Math.atan2(dot(d, away), dot(d, right)) / RADIANS);
  return { azimuth, elevation: Math.asin(clamped(dot(d, up), -1, 1)) / RADIANS };
}

/** A pinhole; pictures are measured in fractions from the upper left. */
export class Camera {
  constructor(width, height, fieldOfView) {
    this.fx = 0.5 / Math.tan((fieldOfView * RADIANS) / 2);
    this.fy = (this.fx * width) / height;
  }

  /** Fractions at which a point is seen; null from behind. */
  project([x, y, z]) {
    return z > -1e-6 ? null : [0.5 - (x / z) * this.fx, 0.5 + (y / z) * this.fy];
  }

  /** Unit vector from the camera through a place in the picture. */
  ray([x, y]) {
    return unit([(x - 0.5) / this.fx, (0.5 - y) / this.fy, -1]);
  }
}

/** Distances at which a ray from the origin meets a sphere, near first; null if it passes. */
export function meetSphere(ray, centre, radius) {
  const along = dot(ray, centre);
  const square = along * along - dot(centre, centre) + radius * radius;
  if (square < 0) return null;
  return [along - Math.sqrt(square), along + Math.sqrt(square)];
}
