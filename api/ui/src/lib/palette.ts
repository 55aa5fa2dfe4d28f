/** Colours of curves that stand beside each other, by their names in the theme; with more curves they come again. */
const NAMES = ['--accent', '--series-2', '--series-3', '--series-4', '--series-5', '--series-6'];

export const COLOURS = NAMES.length;

export function seriesColour(place: number): string {
  return NAMES[place % NAMES.length]!;
}

/** From small to large: hues of viridis, as light or dark as each ground needs them; brightness rises all the way. */
const SEQUENCE = {
  dark: ['#6b82e0', '#3d9ac4', '#2bb39a', '#5ec962', '#a8db34', '#fde725'],
  light: ['#440154', '#46327e', '#365c8d', '#277f8e', '#1d8f6a', '#5f9411'],
};

/** The colour of `value` in a sequence from `low` to `high`, e.g. of an incident angle among all. */
export function sequentialColour(value: number, low: number, high: number, theme: 'dark' | 'light'): string {
  const stops = SEQUENCE[theme];
  const share = high > low ? Math.min(1, Math.max(0, (value - low) / (high - low))) : 0.5;
  const place = share * (stops.length - 1);
  const at = Math.min(Math.floor(place), stops.length - 2);
  const part = (stop: string, i: number): number => parseInt(stop.slice(1 + 2 * i, 3 + 2 * i), 16);
  const mixed = [0, 1, 2].map((i) => Math.round(part(stops[at]!, i) + (place - at) * (part(stops[at + 1]!, i) - part(stops[at]!, i))));
  return `#${mixed.map((v) => v.toString(16).padStart(2, '0')).join('')}`;
}
