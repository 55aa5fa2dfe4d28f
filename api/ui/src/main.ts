import { mount } from 'svelte';
import App from './App.svelte';
import './app.css';
import { start as followLinks } from './lib/router.svelte';
import { begin } from './lib/session.svelte';
import { start as colour } from './lib/theme.svelte';

colour();
followLinks();
void begin();
addEventListener('hashchange', () => {
  if (location.hash.startsWith('#token=')) void begin(); // pasted into a page that is open
});
mount(App, { target: document.getElementById('app')! });
