// node bridge.mjs ELF LINK: the emulated board's USB as a serial port at LINK, at most in real time,
// so that programs that open serial ports can be tried without a board. Needs socat, which owns the
// pseudo-terminal; started anew for each client. Says `ready LINK` each time that LINK can be opened.
import { spawn } from 'node:child_process';
import { existsSync, rmSync } from 'node:fs';
import net from 'node:net';
import { HZ } from './pico.mjs';
import { Session } from './serve.mjs';

const [elf, link] = process.argv.slice(2);
if (!link) {
  console.error('usage: node bridge.mjs ELF LINK');
  process.exit(2);
}
const session = new Session(elf);
const { pico } = session;
// 3 mm from home at 800 steps/mm, 305 mm long, with a camera that exposes for 2 ms.
session.command('slide 2400 244000');
session.command(`camera ${HZ / 10_000} ${HZ / 500}`);
let client;
pico.onData = (data) => client?.write(data);

const socket = `${link}.sock`;
for (const file of [socket, link]) rmSync(file, { force: true });
let child;
const terminal = () => {
  child = spawn('socat', [`PTY,link=${link},raw,echo=0,wait-slave,pty-interval=0.01`, `UNIX-CONNECT:${socket}`], { stdio: 'inherit' });
  child.on('error', (error) => {
    console.error(`socat: ${error.message}`);
    process.exit(1);
  });
  const seen = setInterval(() => {
    if (!existsSync(link)) return;
    clearInterval(seen);
    console.log(`ready ${link}`);
  }, 5);
  child.on('exit', () => {
    clearInterval(seen);
    rmSync(link, { force: true });
    setTimeout(terminal, 10);
  });
};
net
  .createServer((connection) => {
    client = connection;
    connection.on('data', (data) => pico.send(data));
    connection.on('error', () => {});
    connection.on('close', () => {
      if (client === connection) client = undefined;
    });
  })
  .listen(socket, terminal);
const end = () => {
  child?.removeAllListeners('exit');
  child?.kill();
  for (const file of [socket, link]) rmSync(file, { force: true });
  process.exit(0);
};
process.on('SIGTERM', end);
process.on('SIGINT', end);

// At most real time, in slices of a millisecond; more than 50 ms behind is given up.
let began = process.hrtime.bigint();
let at = pico.cycle;
const turn = () => {
  const due = () => at + (Number(process.hrtime.bigint() - began) * HZ) / 1e9;
  if (due() - pico.cycle > HZ / 20) {
    at = pico.cycle;
    began = process.hrtime.bigint();
  }
  // A few at a time: the host's bytes must get in even where the emulator is slower than the board.
  for (let slice = 0; slice < 4 && pico.cycle < due(); slice++) pico.run(HZ / 1000);
  (pico.cycle > due() ? setTimeout : setImmediate)(turn, 1);
};
turn();
