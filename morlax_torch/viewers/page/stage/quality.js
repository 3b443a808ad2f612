// How finely to draw: coarser where frames take long, so that the robot moves in real time.

const LEVELS = [
  { share: 1, shadow: 2048 }, // of the screen's pixels in each direction, and pixels of the shadow
  { share: 0.7, shadow: 1024 },
  { share: 0.5, shadow: 512 },
];
const SLOW = 60; // ms of a frame
const LASTING = 3000; // ms of slow frames in a row until the level falls
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i; // WebGL without a graphics card
const LONGEST = 500; // ms that count of one frame, because a hidden page draws none

/** Return whether a graphics card draws, and not the processor. */
export function isAccelerated() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return false;
  const known = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(known?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER);
  context.getExtension("WEBGL_lose_context")?.loseContext(); // browsers allow a few contexts only
  return !SOFTWARE.test(name);
}

export class Quality {
  /** @param accelerated see `isAccelerated`. */
  constructor(accelerated) {
    this.level = accelerated ? 0 : LEVELS.length - 1;
    this.slow = 0;
  }

  get share() {
    return LEVELS[this.level].share;
  }

  get shadow() {
    return LEVELS[this.level].shadow;
  }

  /** Note how many milliseconds a frame took. */
  note(duration) {
    this.slow = duration > SLOW ? this.slow + Math.min(duration, LONGEST) : 0;
    if (this.slow < LASTING || this.level === LEVELS.length - 1) return;
    this.level += 1;
    this.slow = 0;
  }
}
