/* Asks `horizonval serve` for one image and writes it as PGM. Plain POSIX, no library.
 *
 *   cc -O2 -Wall -o client client.c
 *   ./client SOCKET [KEY VALUE]... > image.pgm      as in: ./client s.sock roll_deg 2.0 seed 7 truth true > image.pgm
 *
 * A message is "HVS1", the length of its body (4 bytes, most significant first), and the body: one MessagePack map.
 * Numbers with a point go as float64, others as integers; "1.0,2.0,3.0" as a list; true and false; the rest as text. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

typedef struct { const uint8_t *p, *end; } View; /* a value and what follows it */

static void fail(const char *what) {
  fprintf(stderr, "client: %s\n", what);
  exit(1);
}

/* Writing: a request is short, so a fixed buffer does. */
static uint8_t out[4096];
static size_t used = 8; /* the header comes first */

static void put(const void *data, size_t count) {
  if (count > sizeof out - used) fail("the request is too long");
  memcpy(out + used, data, count);
  used += count;
}

static void put_big_endian(uint8_t tag, uint64_t value, int bytes) {
  put(&tag, 1);
  for (int i = bytes - 1; i >= 0; i--) put(&(uint8_t){value >> 8 * i}, 1);
}

static void put_text(const char *text) {
  put_big_endian(0xda, strlen(text) & 0xffff, 2);
  put(text, strlen(text) & 0xffff);
}

static void put_double(double value) {
  uint64_t bits;
  memcpy(&bits, &value, 8);
  put_big_endian(0xcb, bits, 8);
}

static void put_word(char *word) {
  char *end;
  if (!strcmp(word, "true") || !strcmp(word, "false")) {
    put(&(uint8_t){word[0] == 't' ? 0xc3 : 0xc2}, 1);
  } else if (strchr(word, ',')) {
    uint64_t count = 1;
    for (char *c = word; *c; c++) count += *c == ',';
    put_big_endian(0xdc, count, 2);
    for (char *part = strtok(word, ","); part; part = strtok(NULL, ",")) put_double(strtod(part, NULL));
  } else {
    long long whole = strtoll(word, &end, 10);
    if (*word && !*end) {
      put_big_endian(0xd3, (uint64_t)whole, 8);
      return;
    }
    double value = strtod(word, &end);
    if (*word && !*end) put_double(value);
    else put_text(word);
  }
}

/* Reading: every step is checked against the end of the message. */
static uint64_t big_endian(View *v, int bytes) {
  uint64_t value = 0;
  if (v->end - v->p < bytes) fail("the reply ends too early");
  while (bytes--) value = value << 8 | *v->p++;
  return value;
}

/* Takes the tag of a value; gives the kind ('i'nteger, 'd'ouble, 's'tring, 'b'inary, 'a'rray, 'm'ap, 'n'one of them)
 * and its number: the value of an integer, the bits of a double, or a length. */
static char tag(View *v, uint64_t *number) {
  uint8_t t = (uint8_t)big_endian(v, 1);
  *number = 0;
  if (t < 0x80) return *number = t, 'i';
  if (t < 0x90) return *number = t & 0x0f, 'm';
  if (t < 0xa0) return *number = t & 0x0f, 'a';
  if (t < 0xc0) return *number = t & 0x1f, 's';
  if (t >= 0xe0) return *number = (uint64_t)(int64_t)(int8_t)t, 'i';
  if (t == 0xc0 || t == 0xc2 || t == 0xc3) return *number = t == 0xc3, 'n';
  if (t >= 0xc4 && t <= 0xc6) return *number = big_endian(v, 1 << (t - 0xc4)), 'b';
  if (t == 0xcb) return *number = big_endian(v, 8), 'd';
  if (t >= 0xcc && t <= 0xcf) return *number = big_endian(v, 1 << (t - 0xcc)), 'i';
  if (t >= 0xd0 && t <= 0xd3) return *number = big_endian(v, 1 << (t - 0xd0)), 'i'; /* ours are never negative */
  if (t >= 0xd9 && t <= 0xdb) return *number = big_endian(v, 1 << (t - 0xd9)), 's';
  if (t == 0xdc || t == 0xdd) return *number = big_endian(v, t == 0xdc ? 2 : 4), 'a';
  if (t == 0xde || t == 0xdf) return *number = big_endian(v, t == 0xde ? 2 : 4), 'm';
  fail("the reply holds a value of a kind that is not used");
  return 0;
}

static void skip(View *v, int depth) {
  uint64_t n;
  char kind = tag(v, &n);
  if (depth > 64) fail("the reply is nested too deeply");
  if (kind == 's' || kind == 'b') {
    if (n > (uint64_t)(v->end - v->p)) fail("the reply ends too early");
    v->p += n;
  }
  if (kind == 'm') n *= 2;
  if (kind == 'm' || kind == 'a')
    while (n--) skip(v, depth + 1);
}

/* Finds a key of a map; gives 0 where it has none. */
static int find(View map, const char *key, View *value) {
  uint64_t entries, length;
  if (tag(&map, &entries) != 'm') fail("the reply is no map");
  while (entries--) {
    View name = map;
    skip(&map, 0);
    if (tag(&name, &length) == 's' && length == strlen(key) && !memcmp(name.p, key, length)) return *value = map, 1;
    skip(&map, 0);
  }
  return 0;
}

/* Gives a value of the kind that is expected, its bytes or entries behind it. */
static View need(View map, const char *key, char kind, uint64_t *number) {
  View value;
  if (!find(map, key, &value) || tag(&value, number) != kind) fail("the reply lacks a key, or it is of another kind");
  if ((kind == 's' || kind == 'b') && *number > (uint64_t)(value.end - value.p)) fail("the reply ends too early");
  return value;
}

static void read_all(int stream, uint8_t *into, size_t count) {
  while (count) {
    ssize_t n = read(stream, into, count);
    if (n <= 0) fail("the connection is lost");
    into += n;
    count -= (size_t)n;
  }
}

int main(int argc, char **argv) {
  struct sockaddr_un address = {.sun_family = AF_UNIX};
  if (argc < 2 || argc % 2 || strlen(argv[1]) >= sizeof address.sun_path) fail("usage: client SOCKET [KEY VALUE]...");
  strcpy(address.sun_path, argv[1]);
  put_big_endian(0xde, (uint64_t)(argc / 2 + 1), 2);
  put_text("schema"), put_text("horizonval/1");
  put_text("kind"), put_text("image");
  for (int i = 2; i < argc; i += 2) put_text(argv[i]), put_word(argv[i + 1]);
  memcpy(out, "HVS1", 4);
  for (int i = 0; i < 4; i++) out[4 + i] = (uint8_t)((used - 8) >> (24 - 8 * i));

  int stream = socket(AF_UNIX, SOCK_STREAM, 0);
  if (stream < 0 || connect(stream, (struct sockaddr *)&address, sizeof address)) fail("nobody listens there");
  for (size_t sent = 0; sent < used;) {
    ssize_t n = send(stream, out + sent, used - sent, MSG_NOSIGNAL);
    if (n <= 0) fail("the connection is lost");
    sent += (size_t)n;
  }
  uint8_t header[8];
  read_all(stream, header, 8);
  View size = {header + 4, header + 8};
  if (memcmp(header, "HVS1", 4)) fail("that is no server of images");
  uint64_t length = big_endian(&size, 4), n, rows, columns, count;
  uint8_t *body = malloc(length + 1);
  if (!body) fail("no memory");
  read_all(stream, body, length);

  View reply = {body, body + length}, value = need(reply, "kind", 's', &n);
  if (n == 5 && !memcmp(value.p, "error", 5)) {
    value = need(reply, "line", 's', &n);
    fprintf(stderr, "client: %.*s\n", (int)n, (const char *)value.p);
    exit(1);
  }
  View dn = need(reply, "dn", 'm', &n);
  find(reply, "dn", &dn);
  View shape = need(dn, "shape", 'a', &n);
  if (n != 2 || tag(&shape, &rows) != 'i' || tag(&shape, &columns) != 'i') fail("dn has no two sides");
  View data = need(dn, "data", 'b', &count);
  if (rows > 16384 || columns > 16384 || count != 2 * rows * columns) fail("dn has another size than it says");
  need(reply, "full_scale", 'i', &n);
  printf("P5 %d %d %d\n", (int)columns, (int)rows, n > 255 ? (int)n : 256); /* 256: always two bytes per pixel */
  for (uint64_t i = 0; i < count; i += 2) putchar(data.p[i + 1]), putchar(data.p[i]); /* PGM: high byte first */

  View truth;
  if (find(reply, "truth", &truth)) {
    View nadir = need(truth, "nadir_geocentric_cam", 'a', &n);
    fprintf(stderr, "nadir_geocentric_cam");
    for (uint64_t i = 0, bits; i < n; i++) {
      double component;
      if (tag(&nadir, &bits) != 'd') fail("the nadir has a component that is no number");
      memcpy(&component, &bits, 8);
      fprintf(stderr, " %.17g", component);
    }
    fprintf(stderr, "\n");
  }
  free(body);
  return ferror(stdout) || fflush(stdout) ? 1 : 0;
}
