// Show the policy under the pointer or the keyboard's focus in every plot of its front.
for (const figure of document.querySelectorAll(".front")) {
  const links = [...figure.querySelectorAll("a")];
  const shown = figure.querySelector("output");
  const show = (link) => {
    const address = link.getAttribute("href");
    for (const other of links)
      other.classList.toggle("chosen", other.getAttribute("href") === address);
    shown.textContent = link.querySelector("title").textContent;
  };
  links.forEach((link, index) => {
    link.tabIndex = index ? -1 : 0; // one stop of the Tab key; arrow keys go on from there
    link.addEventListener("pointerenter", () => show(link));
    link.addEventListener("focus", () => show(link));
    link.addEventListener("click", (event) => { event.preventDefault(); link.focus(); });
    link.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (!step) return;
      event.preventDefault();
      links[(index + step + links.length) % links.length].focus();
    });
  });
}
