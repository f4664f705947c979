// The page's words in the language that is chosen now.

import type { GatewayError } from "./live/message";
import { preferences } from "./state.svelte";
import { type Given, type Key, KNOWN, LANGUAGES, say } from "./words";

export function t<K extends Key>(key: K, ...given: Given<K>): string {
  return say(preferences.language, key, ...given);
}

/** A word of the interface, translated where the page knows it, else as it is. */
export function known(word: string): string {
  const texts = KNOWN[word] ?? KNOWN[word.replaceAll("_", " ")];
  return texts?.[LANGUAGES.indexOf(preferences.language)] ?? word;
}

/** A refusal for people: the server's words, or the page's where the server said nothing. */
export function refusal(refused: GatewayError): GatewayError {
  if (refused.code !== "page.unreachable") return refused;
  return { ...refused, message: t("unreachable"), hint: t("unreachable_hint") };
}
