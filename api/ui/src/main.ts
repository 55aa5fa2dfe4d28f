import { mount } from 'svelte';
import App from './App.svelte';
import './app.css';
import { start as followLinks } from './lib/router.svelte';
import { begin } from './lib/session.svelte';
import { start as colour } from './lib/theme.svelte';

colour();
followLinks();
void begin();
mount(App, { target: document.getElementById('app')! });
