/** How numbers are written: with their unit, and an uncertainty in brackets. */

/** Name of a bench that nobody named: where there is only one, there is nothing to tell it from. */
export const UNNAMED = 'bench';

const MINUS = '\u2212';
const RAISED: Record<string, string> = { '-': '⁻', '0': '⁰', '1': '¹', '2': '²', '3': '³', '4': '⁴', '5': '⁵', '6': '⁶', '7': '⁷', '8': '⁸', '9': '⁹' };

export function number(value: number | null | undefined, digits = 2): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return '–';
  return value.toFixed(digits).replace('-', MINUS);
}

/** Three or four significant figures, without an exponent where that is readable. */
export function significant(value: number | null | undefined, figures = 3): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return '–';
  const size = Math.abs(value);
  const text = size !== 0 && (size < 1e-4 || size >= 1e5) ? value.toExponential(figures - 1) : String(Number(value.toPrecision(figures)));
  return text.replace(/e\+?(-?\d+)$/, (_, power: string) => ` × 10${[...power].map((each) => RAISED[each]).join('')}`).replaceAll('-', MINUS);
}

/** `1.234(12)`: the last two figures of the standard uncertainty in brackets. */
export function uncertain(value: number | null | undefined, u: number | null | undefined): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return '–';
  if (u === null || u === undefined || !(u > 0) || !Number.isFinite(u)) return significant(value);
  const digits = 1 - Math.floor(Math.log10(u));
  if (digits > 8) return significant(value, 6);
  if (digits <= 0) return `${number(value, 0)}(${u.toFixed(0)})`;
  const shown = u < 1 ? String(Math.round(u * 10 ** digits)) : u.toFixed(digits);
  return `${number(value, digits)}(${shown})`;
}

/** A large number in groups of three digits: `200 000`. */
export function grouped(value: number): string {
  return Math.round(value).toString().replace(/\B(?=(\d{3})+$)/g, '\u202f').replace('-', MINUS);
}

/** An integration time: `8.0 ms`, `1.25 s`, `30 s`. */
export function integration(seconds: number): string {
  return seconds < 1 ? `${(1000 * seconds).toFixed(seconds < 0.1 ? 1 : 0)} ms` : `${significant(seconds)} s`;
}

export function degrees(value: number | null | undefined, digits = 2): string {
  const text = number(value, digits);
  return text === '–' ? text : `${text}°`;
}

/** Seconds as a person says them: `45 s`, `12 min`, `3 h 05 min`. */
export function duration(seconds: number | null | undefined): string {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return '–';
  if (seconds < 90) return `${Math.round(seconds)} s`;
  const minutes = Math.round(seconds / 60);
  if (minutes < 90) return `${minutes} min`;
  return `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, '0')} min`;
}

/** A moment in the time of the reader. */
export function moment(text: string | null | undefined): string {
  return text ? new Date(text).toLocaleString(undefined, { dateStyle: 'medium', timeStyle: 'short' }) : '–';
}
