"use strict";
const picture = document.querySelector("#tissue"), status = document.querySelector("#status");
const name = picture.getAttribute("src");
let missing = 0;
function renew() {
  const next = new Image();
  next.onload = () => { missing = 0; picture.src = next.src; setTimeout(renew, 2000); };
  next.onerror = () => {
    missing += 1; // once may be chance: the picture is being replaced
    if (missing < 3) { setTimeout(renew, 1000); return; }
    status.textContent = "The run has ended. Its report follows here.";
    setTimeout(() => location.replace("report.html"), 3000);
  };
  next.src = `${name}?${Date.now()}`;
}
setTimeout(renew, 2000);
