// SPDX-FileCopyrightText: 2026 The ros2_deepc authors
// SPDX-License-Identifier: Apache-2.0
// Opens a report in Chromium, light, dark and narrow, zooms with the mouse, and prints one JSON line for each: what the
// console said, what was asked of the network, and what can be seen. Usage: node open.mjs CHROMIUM FILE FOLDER
import { chromium } from "playwright-core";

const [executablePath, file, folder] = process.argv.slice(2);
const LOOKS = {
  light: { colorScheme: "light", viewport: { width: 1280, height: 900 } },
  dark: { colorScheme: "dark", viewport: { width: 1280, height: 900 } },
  narrow: { colorScheme: "light", viewport: { width: 420, height: 900 } },
};

const colours = (canvas) => {  // how many different ones there are on it
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return new Set(new Uint32Array(data.buffer)).size;
};
const picture = (canvas) => canvas.toDataURL();

const args = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync"];
const browser = await chromium.launch({ executablePath, args });
for (const [name, look] of Object.entries(LOOKS)) {
  const context = await browser.newContext(look), page = await context.newPage(), said = [], asked = [];
  page.on("console", (message) => said.push(`${message.type()}: ${message.text()}`));
  page.on("pageerror", (error) => said.push(`error: ${error.message}`));
  page.on("request", (request) => asked.push(request.url()));
  await page.goto(`file://${file}`);
  const first = page.locator("canvas").first(), before = await first.evaluate(picture);
  const seen = await page.evaluate(() => ({
    wide: document.documentElement.scrollWidth > document.documentElement.clientWidth,
    paper: getComputedStyle(document.body).backgroundColor,
    text: document.body.innerText,
  }));
  const canvases = await page.locator("canvas").evaluateAll((all, f) => all.map(eval(f)), colours.toString());
  await page.screenshot({ path: `${folder}/${name}.png`, fullPage: true });
  const box = await first.boundingBox(), y = box.y + box.height / 2;
  await page.mouse.move(box.x + box.width * 0.4, y);
  const pointed = await first.evaluate(picture);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width * 0.6, y, { steps: 3 });
  await page.mouse.up();
  await page.mouse.move(2, 2);
  const zoomed = await first.evaluate(picture);
  await first.dblclick();
  await page.mouse.move(2, 2);
  const whole = await first.evaluate(picture);
  console.log(JSON.stringify({
    name, said, asked, canvases, ...seen, points: pointed !== before, zooms: zoomed !== before, returns: whole === before,
  }));
  await context.close();
}
await browser.close();
