// State of the page: the view, kept in the URL, and what a person prefers, kept in
// the browser.

import type { System } from "./units";
import { parse, type View, write } from "./view";
import type { Language } from "./words";

export type Theme = "auto" | "light" | "dark";

const KEPT_AFTER_MS = 200;
const system = matchMedia("(prefers-color-scheme: dark)");

export const view: View = $state(parse(location.hash));

class Preferences {
  language = $state<Language>(stored("language", ["en", "zh"]) ?? spoken());
  theme = $state<Theme>(stored("theme", ["auto", "light", "dark"]) ?? "auto");
  units = $state<System>(stored("units", ["shop", "si"]) ?? "shop");
  private night = $state(system.matches);

  constructor() {
    system.addEventListener("change", () => (this.night = system.matches));
  }

  /** True for the dark theme. */
  get dark(): boolean {
    return this.theme === "dark" || (this.theme === "auto" && this.night);
  }
}

export const preferences = new Preferences();

/** Keeps URL, browser and document as the state is. Called once, while a component is made. */
export function keep(): void {
  $effect(() => {
    const hash = write(view);
    const later = window.setTimeout(() => {
      history.replaceState(null, "", hash ? `#${hash}` : location.pathname);
    }, KEPT_AFTER_MS);
    return () => window.clearTimeout(later);
  });
  // Before pictures ask what a colour comes to.
  $effect.pre(() => {
    document.documentElement.lang = preferences.language === "zh" ? "zh-Hans" : "en";
    document.documentElement.dataset.theme = preferences.theme;
    for (const key of ["language", "theme", "units"] as const) store(key, preferences[key]);
  });
  window.addEventListener("hashchange", () => Object.assign(view, parse(location.hash)));
}

function spoken(): Language {
  return navigator.language.startsWith("zh") ? "zh" : "en";
}

function stored<T extends string>(key: string, all: readonly T[]): T | undefined {
  try {
    const value = localStorage.getItem(`polepair.${key}`);
    return all.find((each) => each === value);
  } catch {
    return undefined;
  }
}

function store(key: string, value: string): void {
  try {
    localStorage.setItem(`polepair.${key}`, value);
  } catch {
    // A browser that keeps nothing loses nothing else.
  }
}
