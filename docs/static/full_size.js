/* A picture that is shown smaller than it is opens in its full size on a click. */
"use strict";

window.addEventListener("load", () => {
    for (const picture of document.querySelectorAll("article img")) {
        if (picture.closest("a") || picture.naturalWidth <= picture.clientWidth) continue;
        const link = document.createElement("a");
        link.href = picture.src;
        link.title = "Full size";
        picture.replaceWith(link);
        link.append(picture);
    }
});
