// The player of replays: time, stages, speed, orbit, and a second replay beside or over the first.
import { clipName, inflate, nearestReplay } from "./data.js";
import { byId, cssColour, element, shortenToFit, pointerPosition, prepareCanvas } from "./dom.js";
import { historyView } from "./history.js";
import { endTime, frameAt, bodyPoses, readMotion, stateAt, withMeshes } from "./kinematics.js";
import { clamp, formatShort } from "./numbers.js";
import { recordVideo } from "./export.js";
import { basePosition, drawForces, drawPushes, drawRobot, drawWorld, makeView } from "./scene.js";
import { leastHiddenAngle, robotSize, viewingDistance, START_VIEW } from "./camera.js";
import { drawStages } from "./timeline.js";
import { formatColumnValue } from "./map.js";

/** @import { Model, Motion } from "./kinematics.js" */
/** @import { App } from "./main.js" */
/** @import { Camera } from "./scene.js" */

/**
 * @typedef {object} Reel
 * @property {number} number
 * @property {Model} model
 * @property {Motion} motion
 * @property {{ metres: number, least: number }} arrow of a force: m per N, and the smallest force with an arrow
 */

/**
 * @typedef {object} Player
 * @property {(row: number, at?: number | null) => void} openRow opens the replay of a row, or the nearest one, from the start or
 *   paused at a time
 * @property {() => number | null} time s, while paused
 * @property {() => [number, number] | null} span part of the time that the plots show, s
 * @property {() => void} draw
 */

const GHOST_COLOUR = /** @type {[number, number, number]} */ ([140, 86, 190]);
const PAUSE_AT_END = 0.8; // s before a finished replay starts again
const FOLLOW_SHARE = 0.12; // share of the distance to the base that the camera moves in each frame

/** @type {(app: App) => Player} */
export function makePlayer(app) {
  const { table } = app;
  const { replays } = table.about;
  const panel = byId("replay");
  const canvases = ["scene-a", "scene-b"].map((id) => /** @type {HTMLCanvasElement} */ (byId(id)));
  const [list, beside, mode, speed] = ["replay-list", "replay-with", "replay-mode", "replay-speed"].map(
    (id) => /** @type {HTMLSelectElement} */ (byId(id)),
  );
  const play = byId("play");
  const scrub = /** @type {HTMLInputElement} */ (byId("scrub"));
  const strip = /** @type {HTMLCanvasElement} */ (byId("strip"));
  const [clock, note, caption] = ["clock", "replay-note", "replay-about"].map(byId);

  /** @type {Map<number, Promise<Reel>>} */
  const reels = new Map();
  /** @type {Promise<Model[]> | null} */
  let models = null;
  /** @type {(Reel | null)[]} */
  let open = [null, null];
  const asked = [-1, -1]; // numbers of the replays chosen last
  let time = 0;
  let spokenTime = 0; // time of the last text shown
  let playing = false;
  let next = 0; // pending animation frame: never two at a time, however often a replay is opened
  let last = 0;
  /** @type {Camera} */
  let camera = { ...START_VIEW, distance: 3, target: [0, 0, 0] };
  let waited = 0;
  /** @type {{ stop: () => void, taken: () => void } | null} */
  let film = null;
  let turned = false; // whether the user has turned the view
  /** @type {Map<number, [number, number]>} */
  const fingers = new Map();

  if (!replays.length) {
    note.textContent = `No rollout has a replay yet. This adds some: sweep report ${clipName(table.about.folder)} --replays 6`;
    return { openRow: () => {}, draw: () => {}, time: () => null, span: () => null };
  }
  const histories = historyView(app, (at) => {
    if (playing) stop();
    to(at);
  });
  const groups = () =>
    table.about.kinds.flatMap(({ key, label }) => {
      const own = replays.flatMap((one, number) => (one.kind === key ? [number] : []));
      const options = own.map((number) => element("option", { value: String(number) }, replayTitle(app, number)));
      return own.length ? [element("optgroup", { label: clipName(label) }, ...options)] : [];
    });
  list.replaceChildren(...groups());
  beside.replaceChildren(element("option", { value: "" }, "nothing"), ...groups());

  /** @type {(number: number) => Promise<Reel>} */
  const reelOf = (number) => {
    models ??= inflate(table.about.models).then((buffer) =>
      JSON.parse(new TextDecoder().decode(buffer)).map(withMeshes),
    );
    const known = reels.get(number);
    if (known) return known;
    const shown = replays[number];
    const made = Promise.all([models, inflate(app.stream(number))]).then(([all, buffer]) => {
      const model = all[shown.model];
      const motion = readMotion(shown, model, buffer);
      return { number, model, motion, arrow: arrowOf(model, motion) };
    });
    reels.set(number, made);
    return made;
  };

  /**
   * @param {number} which 0, or 1 for the second replay
   * @param {number} number -1 to close it
   * @param {string} said
   * @returns {Promise<boolean>} whether it is shown: false if another one was chosen meanwhile
   */
  const openReel = async (which, number, said = "") => {
    asked[which] = number;
    const reel = number < 0 ? null : await reelOf(number);
    if (asked[which] !== number) return false;
    open[which] = reel;
    (which ? beside : list).value = reel ? String(number) : "";
    if (reel && which === 0) {
      note.textContent = said;
      time = reel.motion.step;
      const target = basePosition(reel.model, posesAt(reel));
      camera = {
        ...camera,
        target,
        distance: viewingDistance(reel),
        azimuth: turned ? camera.azimuth : leastHiddenAngle(reel),
      };
      describe();
    }
    panel.classList.toggle("two", Boolean(open[1]));
    panel.classList.toggle("ghost", mode.value === "ghost");
    scrub.max = String(lengthOf());
    histories.show(open, lengthOf());
    drawStrip();
    draw();
    return true;
  };

  /** @type {(row: number, at?: number | null) => void} */
  const openRow = (row, at = null) => {
    const number = nearestReplay(table, row);
    if (number < 0) return;
    const other = replays[number].row;
    let said = "";
    if (other !== row) {
      const differ = table.columns.filter((column) => column.axis && column.values[row] !== column.values[other]);
      const apart = differ
        .slice(0, 4)
        .map(
          (column) =>
            `${column.label} ${formatColumnValue(column, column.values[other])} instead of ${formatColumnValue(column, column.values[row])}`,
        );
      const ends =
        table.kind[row] === table.kind[other]
          ? ""
          : `; it ends as ${table.about.kinds[table.kind[other]].label}, not as ${table.about.kinds[table.kind[row]].label}`;
      if (!apart.length) apart.push("the same values with other noise");
      said = `Another row: the one you chose has no replay. This is the nearest that has one: ${apart.join(", ")}${differ.length > 4 ? ", …" : ""}${ends}.`;
    }
    time = 0;
    const pair = replays.findIndex((one) => one.row < 0 && one.point === replays[number].point);
    void openReel(0, number, said).then(async (opened) => {
      if (!opened) return;
      if (pair >= 0) await openReel(1, pair);
      if (at === null) start();
      else to(at);
    });
  };

  const describe = () => {
    const reel = open[0];
    if (!reel) return;
    const shown = replays[reel.number];
    const left = table.about.left_out ? ` ${table.about.left_out} more replays have no room on this page.` : "";
    const same =
      shown.equal === shown.of
        ? "all figures equal to the last bit"
        : `${shown.equal} of ${shown.of} figures equal to the last bit`;
    caption.textContent = `${shown.why ? `${clipName(shown.why)}. ` : ""}Simulated again from row ${shown.point}: ${same}.${left}`;
  };

  const lengthOf = () => Math.max(0.1, ...open.map((reel) => (reel ? endTime(reel.motion) : 0)));

  const draw = () => {
    const [a, b] = open;
    if (!a) return;
    const ghost = mode.value === "ghost";
    scene(canvases[0], a, b && ghost ? b : null);
    if (b && !ghost) scene(canvases[1], b, null);
    film?.taken();
    drawStrip();
    histories.point(time);
    if (!playing || Math.floor(10 * time) !== Math.floor(10 * spokenTime)) tell(a);
  };

  /**
   * Show the time as text. The browser then updates its layout, so during playback it happens ten times a second.
   * @param {Reel} reel
   */
  const tell = (reel) => {
    spokenTime = time;
    const stage = stageOf(reel);
    scrub.value = String(time);
    clock.textContent = `${time.toFixed(2)} s`;
    byId("stage").textContent = stage;
    scrub.setAttribute("aria-valuetext", `${time.toFixed(1)} seconds, ${stage}`);
  };

  /**
   * Poses of a replay's bodies at the present time.
   * @param {Reel} reel
   */
  const posesAt = ({ model, motion }) => bodyPoses(model, stateAt(motion, time));

  /** @type {(reel: Reel) => string} */
  const stageOf = ({ motion, number }) => clipName(replays[number].stages[motion.stage[frameAt(motion, time)]] ?? "");

  /** @type {(canvas: HTMLCanvasElement, reel: Reel, ghost: Reel | null) => void} */
  const scene = (canvas, reel, ghost) => {
    const { model, motion, arrow } = reel;
    const sheet = prepareCanvas(canvas);
    const theme = app.theme();
    const poses = posesAt(reel);
    const aim = basePosition(model, poses);
    const shift = camera.target.map((part, k) => part + (aim[k] - part) * (playing ? FOLLOW_SHARE : 1));
    if (canvas === canvases[0]) camera = { ...camera, target: shift };
    const view = makeView(sheet, theme, canvas === canvases[0] ? camera : { ...camera, target: aim });
    drawWorld(
      view,
      model,
      poses,
      view.eye.map((part, k) => part + view.axes[2][k] * camera.distance),
    );
    if (ghost) {
      const own = prepareCanvas(overlay(canvas));
      drawRobot({ ...view, sheet: own }, ghost.model, posesAt(ghost), GHOST_COLOUR);
      sheet.pen.globalAlpha = 0.5;
      sheet.pen.drawImage(own.pen.canvas, 0, 0, sheet.width, sheet.height);
      sheet.pen.globalAlpha = 1;
    }
    const frame = frameAt(motion, time);
    const forces = 3 * model.feet.length;
    drawForces(view, model, poses, motion.force.subarray(forces * frame, forces * (frame + 1)), arrow);
    if (motion.pushes.length) drawPushes(view, motion.pushes, poses, time, 3 * robotSize(model));
    const lines = [`${time.toFixed(2)} s   ${stageOf(reel)}`, replayTitle(app, reel.number)];
    if (forces) lines[0] += `   arrows: 100 N are ${formatShort(100 * arrow.metres)} m`;
    if (ghost) lines.push(`violet: ${replayTitle(app, ghost.number)}`);
    sheet.pen.textAlign = "left";
    sheet.pen.textBaseline = "bottom";
    sheet.pen.lineWidth = 3;
    sheet.pen.strokeStyle = cssColour(theme.paper, 0.85);
    lines.forEach((line, k) => {
      sheet.pen.font = sheet.pen.font.replace(/^(bold )?/, k ? "" : "bold ");
      sheet.pen.fillStyle = k ? theme.soft : theme.ink;
      const y = sheet.height - 10 - 17 * (lines.length - 1 - k);
      const text = shortenToFit(sheet.pen, line, sheet.width - 24);
      sheet.pen.strokeText(text, 12, y);
      sheet.pen.fillText(text, 12, y);
    });
  };

  /**
   * Limit arrows to the size of the robot.
   * @type {(model: Model, motion: Motion) => Reel["arrow"]}
   */
  const arrowOf = (model, motion) => {
    const robot = 2 * robotSize(model);
    const most = motion.force.reduce((a, b) => Math.max(a, Math.abs(b)), 1);
    const { metres, least } = table.about.arrow;
    return { metres: Math.min(metres, Number((robot / most).toPrecision(1))), least };
  };

  /** @type {HTMLCanvasElement | null} */
  let second = null;
  /**
   * Hidden canvas of the same size.
   * @type {(canvas: HTMLCanvasElement) => HTMLCanvasElement}
   */
  const overlay = (canvas) => {
    second ??= element("canvas");
    Object.defineProperty(second, "clientWidth", { value: canvas.clientWidth, configurable: true });
    Object.defineProperty(second, "clientHeight", { value: canvas.clientHeight, configurable: true });
    return second;
  };

  const drawStrip = () => open[0] && drawStages(app, strip, open[0], time, lengthOf());

  const start = () => {
    playing = true;
    last = 0;
    play.setAttribute("aria-pressed", "true");
    play.textContent = "❚❚";
    play.setAttribute("aria-label", "pause");
    cancelAnimationFrame(next);
    next = requestAnimationFrame(step);
  };
  const stop = () => {
    playing = false;
    cancelAnimationFrame(next);
    play.setAttribute("aria-pressed", "false");
    play.textContent = "▶";
    play.setAttribute("aria-label", "play");
    draw();
    app.remember();
  };
  /** @param {number} now */
  const step = (now) => {
    if (!playing) return;
    const passed = last ? Math.min(0.1, (now - last) / 1000) : 0;
    last = now;
    time += passed * Number(speed.value);
    const end = lengthOf();
    if (time >= end) {
      time = end;
      waited += passed;
      if (waited > PAUSE_AT_END) [time, waited] = [0, 0];
    }
    if (app.visible(canvases[0])) draw();
    next = requestAnimationFrame(step);
  };
  const to = (/** @type {number} */ value) => {
    time = clamp(value, 0, lengthOf());
    draw();
    app.remember();
  };

  play.addEventListener("click", () => (playing ? stop() : start()));
  scrub.addEventListener("input", () => {
    const chosen = Number(scrub.value); // drawing sets it
    stop();
    to(chosen);
  });
  strip.addEventListener("pointerdown", (event) => {
    stop();
    to((pointerPosition(event, strip)[0] / strip.clientWidth) * lengthOf());
  });
  list.addEventListener("change", () => {
    const number = Number(list.value);
    app.mark(replays[number].row);
    void openReel(0, number);
  });
  beside.addEventListener("change", () => void openReel(1, beside.value === "" ? -1 : Number(beside.value)));
  mode.addEventListener("change", () => {
    panel.classList.toggle("ghost", mode.value === "ghost");
    draw();
  });
  byId("reset").addEventListener("click", () => {
    turned = false;
    if (open[0])
      camera = { ...camera, ...START_VIEW, distance: viewingDistance(open[0]), azimuth: leastHiddenAngle(open[0]) };
    draw();
  });

  const record = byId("record");
  record.addEventListener("click", () => {
    film?.stop();
    film = film ? null : recordVideo(canvases, app.theme().panel);
    record.setAttribute("aria-pressed", String(Boolean(film)));
    if (film && !playing) start();
  });

  const orbit = (/** @type {number} */ dx, /** @type {number} */ dy) => {
    turned = true;
    camera = {
      ...camera,
      azimuth: camera.azimuth - dx / 160,
      elevation: clamp(camera.elevation + dy / 160, 0.03, 1.5),
    };
    if (!playing) draw();
  };
  const zoom = (/** @type {number} */ factor) => {
    camera = { ...camera, distance: clamp(camera.distance * factor, 0.4, 30) };
    if (!playing) draw();
  };
  for (const canvas of canvases) {
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, pointerPosition(event, canvas));
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = pointerPosition(event, canvas);
      fingers.set(event.pointerId, now);
      const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1];
      if (!other) return orbit(now[0] - before[0], now[1] - before[1]);
      const apart = (/** @type {[number, number]} */ p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(apart(before) / Math.max(1, apart(now)));
    });
    for (const name of /** @type {const} */ (["pointerup", "pointercancel"]))
      canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        zoom(Math.exp(clamp(event.deltaY, -200, 200) / 600));
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => {
      const turns = /** @type {Record<string, () => void>} */ ({
        ArrowLeft: () => orbit(-16, 0),
        ArrowRight: () => orbit(16, 0),
        ArrowUp: () => orbit(0, 16),
        ArrowDown: () => orbit(0, -16),
        "+": () => zoom(0.9),
        "-": () => zoom(1.1),
        " ": () => play.click(),
        ",": () => to(time - 0.1),
        ".": () => to(time + 0.1),
      });
      if (!turns[event.key]) return;
      turns[event.key]();
      event.preventDefault();
    });
  }
  const typical = ["typical of success", "nominal parameters"]
    .map((reason) => replays.findIndex(({ why }) => why === reason))
    .find((number) => number >= 0);
  const { open: wanted } = table.about;
  void openReel(0, wanted ? 0 : (typical ?? 0)).then(async (opened) => {
    if (!opened) return;
    if (wanted > 1) await openReel(1, 1);
    if (wanted && !matchMedia("(prefers-reduced-motion: reduce)").matches) start();
  });
  const redraw = () => {
    draw();
    histories.draw();
  };
  return { openRow, draw: redraw, time: () => (playing ? null : time), span: histories.span };
}

/**
 * Title of a replay in lists: its own, or its outcome and parameters.
 * @type {(app: App, number: number) => string}
 */
function replayTitle({ table, ranked }, number) {
  const shown = table.about.replays[number];
  const kind =
    table.about.kinds.find(({ key }) => key === shown.kind)?.label ?? clipName(shown.kind.replaceAll("_", " "));
  if (shown.title) return `${clipName(shown.title)}: ${kind}`;
  if (shown.row < 0) return `${kind}, ${shown.point.slice(0, 6)}`;
  const columns = ranked.map(({ column }) => column).sort((a, b) => Number(!!b.names) - Number(!!a.names));
  const values = columns
    .slice(0, 3)
    .map((column) => `${column.label} ${formatColumnValue(column, column.values[shown.row])}`);
  return `${kind}${values.length ? `: ${values.join(", ")}` : ""}`;
}
