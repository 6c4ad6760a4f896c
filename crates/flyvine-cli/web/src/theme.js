// @ts-check
// Light and dark: the system's choice unless the user made one.

/** Colours that mean the same in light and dark, distinguishable with any colour vision (Okabe and Ito's, and more). */
const PALETTE = [
  "#0072B2", "#D55E00", "#009E73", "#B5519C", "#8A6D00", "#1B8A99", "#5B4BB7", "#8C4A2F", "#4F5B66",
];

export function isDark() {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

/** Switches to the other one. */
export function toggleTheme() {
  document.documentElement.dataset.theme = isDark() ? "light" : "dark";
}

/**
 * A colour, lightened where the page is dark.
 * @param {string} color `#rrggbb`
 */
export function onTheme(color) {
  if (!isDark()) return color;
  const channels = [1, 3, 5].map((i) => parseInt(color.slice(i, i + 2), 16));
  return `#${channels.map((v) => Math.round(v + 0.38 * (255 - v)).toString(16).padStart(2, "0")).join("")}`;
}

/**
 * A colour for each of the shown flights: its configuration's, or another where that is taken.
 * @param {string[]} wanted
 */
export function distinctColors(wanted) {
  /** @type {string[]} */
  const taken = [];
  for (const color of wanted) {
    const free = [color, ...PALETTE].find((candidate) => !taken.includes(candidate));
    taken.push(free ?? color);
  }
  return taken;
}

/** @param {string} name a custom property of style.css */
export function themeColor(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
