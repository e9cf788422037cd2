export { Keyboard, elsewhere } from "./keyboard.js";
export { readGamepad } from "./gamepad.js";
export { Link } from "./link.js";
export { merge } from "./merge.js";
