// Keyboard, gamepad and screen become one pair of sticks. Each counts only while its own dead-man is held, so
// that a drifting gamepad does not move what the keyboard holds; of several, the largest deflection wins.

export function merge(sources) {
  const held = sources.filter((source) => source.deadMan);
  const largest = (axis) =>
    held.map((source) => source.sticks[axis]).reduce((a, b) => (Math.abs(b) > Math.abs(a) ? b : a), 0);
  return { sticks: [0, 1, 2, 3].map(largest), deadMan: held.length > 0 };
}
