// Logs a DC motor for `rig identify`: time, PWM and encoder counts, 100 times a second. Arduino Uno or Nano.
// Send "s" to start. The shaft swings to and fro about where it stands, with two sizes of drive in turn, for 20 s.
const byte PIN_A = 2, PIN_B = 3;      // encoder
const byte PIN_IN1 = 9, PIN_IN2 = 10; // bridge with two inputs that brakes while both are high; its enable tied high
const long SWING = 300;               // counts to each side, after which the drive reverses: the shaft overshoots
const int DRIVES[] = {110, 180};      // of 255; both must turn the motor at once
const unsigned long PERIOD_us = 10000, LONGEST_us = 20000000, STUCK_us = 2000000;

volatile long counts = 0;
volatile byte before = 0;
bool running = false;
int direction = 1, swings = 0;
unsigned long start_us, turned_us, next_us;

byte channels() { return (byte)(digitalRead(PIN_A) << 1 | digitalRead(PIN_B)); }

void edge() { // a row for each state before, a column for each state now
  static const signed char STEP[] = {0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0};
  const byte now = channels();
  counts += STEP[before << 2 | now];
  before = now;
}

void drive(int pwm) { // -255 to 255; 0 brakes
  analogWrite(PIN_IN1, pwm >= 0 ? 255 : 255 + pwm);
  analogWrite(PIN_IN2, pwm >= 0 ? 255 - pwm : 255);
}

void stop(const char *why) {
  running = false;
  drive(0);
  Serial.println(why); // rig skips lines that begin with #
}

void setup() {
  pinMode(PIN_A, INPUT_PULLUP), pinMode(PIN_B, INPUT_PULLUP);
  pinMode(PIN_IN1, OUTPUT), pinMode(PIN_IN2, OUTPUT);
  TCCR1B = (TCCR1B & 0xF8) | 1; // PWM at pins 9 and 10 at 31 kHz instead of 490 Hz
  drive(0);
  before = channels();
  attachInterrupt(digitalPinToInterrupt(PIN_A), edge, CHANGE);
  attachInterrupt(digitalPinToInterrupt(PIN_B), edge, CHANGE);
  Serial.begin(115200);
}

void loop() {
  if (!running) {
    if (Serial.read() != 's') return;
    running = true;
    Serial.println("micros,pwm,counts");
    start_us = turned_us = next_us = micros();
  }
  if ((long)(micros() - next_us) < 0) return;
  next_us += PERIOD_us;
  noInterrupts();
  const long position = counts;
  const unsigned long now_us = micros();
  interrupts();
  if (direction * position > SWING) {
    direction = -direction;
    swings++;
    turned_us = now_us;
  }
  const int pwm = direction * DRIVES[swings / 6 % 2];
  drive(pwm);
  Serial.print(now_us), Serial.print(','), Serial.print(pwm), Serial.print(','), Serial.println(position);
  if (swings == 0 && position < -SWING) stop("# stopped: counts fall. Swap PIN_A and PIN_B");
  else if (now_us - turned_us > STUCK_us) stop("# stopped: no swing in 2 s. Raise DRIVES, or lower SWING");
  else if (now_us - start_us > LONGEST_us) stop("# done");
}
