/** Dark or light: what the computer prefers until a person chooses. */

type Theme = 'dark' | 'light';

const NAME = 'goniometer.theme';
const system = matchMedia('(prefers-color-scheme: light)');

class Chosen {
  theme = $state<Theme>(chosen() ?? preferred());
}

function preferred(): Theme {
  return system.matches ? 'light' : 'dark';
}

function chosen(): Theme | null {
  const kept = localStorage.getItem(NAME);
  return kept === 'dark' || kept === 'light' ? kept : null;
}

export const theme = new Chosen();

system.addEventListener('change', () => {
  if (chosen() === null) theme.theme = preferred();
});

export function start(): void {
  const kept = chosen();
  if (kept) document.documentElement.dataset.theme = kept;
}

export function turn(): void {
  theme.theme = theme.theme === 'dark' ? 'light' : 'dark';
  localStorage.setItem(NAME, theme.theme);
  document.documentElement.dataset.theme = theme.theme;
}
