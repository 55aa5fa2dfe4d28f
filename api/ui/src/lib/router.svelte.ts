/** Every view has an address; the page keeps nothing that the address does not say. */

class Place {
  path = $state(location.pathname);
  query = $state(new URLSearchParams(location.search));
}

export const place = new Place();

function read(): void {
  place.path = location.pathname;
  place.query = new URLSearchParams(location.search);
}

/** Go to an address of this app, e.g. `/datasets/3?point=12`. */
export function go(address: string, replace = false): void {
  if (replace) history.replaceState(null, '', address);
  else history.pushState(null, '', address);
  read();
}

/** Change parts of the query, leaving the rest; null removes. */
export function ask(changes: Record<string, string | number | null>, replace = true): void {
  const query = new URLSearchParams(location.search);
  for (const [name, value] of Object.entries(changes)) {
    if (value === null) query.delete(name);
    else query.set(name, String(value));
  }
  const text = query.toString();
  go(location.pathname + (text ? `?${text}` : ''), replace);
}

/** Parts of the path, e.g. `['datasets', '3']`. */
export function parts(): string[] {
  return place.path.split('/').filter(Boolean).map(decodeURIComponent);
}

/** Follow links of this app without loading the page anew; the back button works. */
export function start(): void {
  addEventListener('popstate', read);
  addEventListener('click', (event) => {
    const link = (event.target as Element | null)?.closest('a');
    if (!link || event.defaultPrevented || event.button || event.ctrlKey || event.metaKey || event.shiftKey) return;
    const url = new URL(link.href, location.href);
    const ours = url.origin === location.origin && !/^\/(api|health|metrics|docs)(\/|$)/.test(url.pathname);
    if (!ours || link.target || link.hasAttribute('download')) return;
    event.preventDefault();
    go(url.pathname + url.search);
  });
}
