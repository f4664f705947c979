// Files that the page makes: they never leave this computer.

export function download(name: string, type: string, content: BlobPart): void {
  const url = URL.createObjectURL(new Blob([content], { type }));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  window.setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** A name with the moment in it, sortable. */
export function dated(what: string, extension: string): string {
  const now = new Date().toISOString().slice(0, 19).replace(/[:T]/g, "-");
  return `polepair-${what}-${now}.${extension}`;
}
