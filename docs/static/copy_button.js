/* A button on each code block that copies its text. Of a session in a shell or in Python, only the input is copied. */
"use strict";

function textOf(block) {
    const text = block.querySelector("pre").innerText;
    const lines = text.split("\n").filter((line) => /^(\$|>>>|\.\.\.) /.test(line));
    return lines.length ? lines.map((line) => line.replace(/^\S+ /, "")).join("\n") + "\n" : text;
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
