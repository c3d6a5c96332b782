import { defineConfig } from "vite";
// Fixed names: the program embeds these files and tells copies apart by their content.
export default defineConfig({
  base: "./",
  build: {
    outDir: "../../server/moldline/page", emptyOutDir: false, modulePreload: false, chunkSizeWarningLimit: 900,
    rollupOptions: { output: { entryFileNames: "page.js", assetFileNames: "page[extname]", format: "es" } },
  },
});
