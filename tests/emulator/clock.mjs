// Time for rp2040js, counted in whole cycles of the 125 MHz system clock (8 ns), so that nothing is
// rounded. It offers what rp2040js asks of its clock: `nanos`, `micros`, `createAlarm`.

export const HZ = 125_000_000;
export const NS = 8;

class Alarm {
  constructor(clock, callback) {
    this.clock = clock;
    this.callback = callback;
    this.at = 0;
    this.scheduled = false;
  }
  schedule(nanos) {
    const clock = this.clock;
    this.at = clock.cycle + Math.max(0, Math.ceil(nanos / NS));
    if (!this.scheduled) {
      this.scheduled = true;
      clock.alarms.push(this);
      if (this.at < clock.due) clock.due = this.at;
    } else {
      clock.refresh();
    }
  }
  cancel() {
    if (!this.scheduled) return;
    this.scheduled = false;
    const { alarms } = this.clock;
    alarms.splice(alarms.indexOf(this), 1);
    this.clock.refresh();
  }
}

export class Clock {
  frequency = HZ;
  cycle = 0;
  /** The cycle at which the next alarm is due. */
  due = Infinity;
  alarms = [];

  get nanos() {
    return this.cycle * NS;
  }
  get micros() {
    return this.nanos / 1000;
  }
  createAlarm(callback) {
    return new Alarm(this, callback);
  }
  refresh() {
    let due = Infinity;
    for (const alarm of this.alarms) if (alarm.at < due) due = alarm.at;
    this.due = due;
  }
  /** Calls every alarm that is due. */
  run() {
    while (this.due <= this.cycle) {
      const at = this.due;
      const i = this.alarms.findIndex((alarm) => alarm.at === at);
      const [alarm] = this.alarms.splice(i, 1);
      alarm.scheduled = false;
      this.refresh();
      alarm.callback();
    }
  }
}
