/* A button on each code block that copies its text. Of a session in a console, only the commands are copied. */
"use strict";

function textOf(block) {
    const text = block.querySelector("pre").innerText;
    const lines = text.split("\n").filter((line) => line.startsWith("$ "));
    return lines.length ? lines.map((line) => line.slice(2)).join("\n") + "\n" : text;
}

for (const block of navigator.clipboard ? document.querySelectorAll(".highlight") : []) {
    const button = document.createElement("button");
    button.className = "copy";
    button.type = "button";
    button.textContent = "Copy";
    button.addEventListener("click", async () => {
        await navigator.clipboard.writeText(textOf(block));
        button.textContent = "Copied";
        setTimeout(() => { button.textContent = "Copy"; }, 1500);
    });
    block.append(button);
}
