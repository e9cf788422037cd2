// A gamepad with the standard mapping: axes 0 to 3 are the two sticks (down is positive), buttons 4 and 5 the
// bumpers, of which one is held as dead-man. Others are named, not used: their axes may be anything.

const BUMPERS = [4, 5];

export function readGamepad() {
  const pads = [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad && pad.connected);
  const good = pads.filter((pad) => pad.mapping === "standard");
  const pad = good.find((one) => pressed(one)) ?? good[0];
  if (!pad) {
    const note = pads.length ? `${pads[0].id}: no standard mapping, not used` : "";
    return { sticks: [0, 0, 0, 0], deadMan: false, note };
  }
  const [leftX, leftY, rightX, rightY] = [0, 1, 2, 3].map((axis) => bounded(pad.axes[axis]));
  return { sticks: [leftX, -leftY, rightX, -rightY], deadMan: pressed(pad), note: pad.id };
}

const pressed = (pad) => BUMPERS.some((index) => pad.buttons[index]?.pressed);
const bounded = (value) => (Number.isFinite(value) ? Math.max(-1, Math.min(1, value)) : 0);
