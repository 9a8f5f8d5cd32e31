// Each picture leads to itself, in its full size.
addEventListener("DOMContentLoaded", () => {
  for (const picture of document.querySelectorAll("article img")) {
    if (picture.closest("a")) continue;
    const link = document.createElement("a");
    link.href = picture.src;
    link.title = "Open the picture";
    picture.replaceWith(link);
    link.append(picture);
  }
});
