import { svelte } from '@sveltejs/vite-plugin-svelte';
import { defineConfig } from 'vite';

export default defineConfig({
  plugins: [svelte()],
  // the bundle ships inside the Python package, so that operators need no Node
  build: { outDir: '../static', emptyOutDir: true, target: 'es2022', modulePreload: { polyfill: false } },
});
