/** Colours of curves that stand beside each other, by their names in the theme; with more curves they come again. */
const NAMES = ['--accent', '--series-2', '--series-3', '--series-4', '--series-5', '--series-6'];

export const COLOURS = NAMES.length;

export function seriesColour(place: number): string {
  return NAMES[place % NAMES.length]!;
}
