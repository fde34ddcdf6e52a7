// Forward kinematics. A placement is 12 numbers: a rotation by rows, then a translation [m].
const HERE = [1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0];

function times(a, b) {
  const c = new Array(12);
  for (let i = 0; i < 3; i++) {
    const [x, y, z] = [a[3 * i], a[3 * i + 1], a[3 * i + 2]];
    for (let j = 0; j < 3; j++) c[3 * i + j] = x * b[j] + y * b[3 + j] + z * b[6 + j];
    c[9 + i] = x * b[9] + y * b[10] + z * b[11] + a[9 + i];
  }
  return c;
}

// A joint's own motion: along its axis, or about it (Rodrigues).
function moved(joint, value) {
  const [x, y, z] = joint.axis;
  if (joint.prismatic) return [1, 0, 0, 0, 1, 0, 0, 0, 1, x * value, y * value, z * value];
  const c = Math.cos(value), s = Math.sin(value), k = 1 - c;
  return [c + x * x * k, x * y * k - z * s, x * z * k + y * s,
          y * x * k + z * s, c + y * y * k, y * z * k - x * s,
          z * x * k - y * s, z * y * k + x * s, c + z * z * k, 0, 0, 0];
}

// The frames at q: the base, every joint, the tool.
function framesAt(q) {
  const frames = [HERE];
  for (const joint of run.arm.joints) {
    const value = joint.factor * q[joint.leader] + joint.offset;
    frames.push(times(times(frames[joint.parent], joint.placement), moved(joint, value)));
  }
  frames.push(times(frames[frames.length - 1], run.arm.tool));
  return frames;
}

const jointColumns = run.columns.map((c) => c.name).filter((name) => /_position_(rad|m)$/.test(name));

// The commanded joints of a bucket, or null where nothing was commanded.
function jointsAt(k) {
  const q = jointColumns.map((name) => columns[name].first[k]);
  return q.length && q.every(Number.isFinite) ? q : null;
}
